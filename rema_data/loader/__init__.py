"""Reading a release for training: decoded once into a cache of plain arrays, then gathered a batch at a time.

Read in this order: ``release`` (what a user opens), ``index`` (the training columns), ``decode``, ``cache`` and
``build`` (from the store to plain arrays), ``dataset``, ``arrays`` and ``metres`` (what a training loop gets),
``batch``, ``convert`` and ``transport`` (the same as tensors, also from worker processes), ``resident`` (the same from
device memory). Only the last four modules import torch.
"""
