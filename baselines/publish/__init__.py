"""``rema publish``: releases and networks as folders that are ready for the Hugging Face Hub.

Read in this order: ``model_card`` (README.md of networks), ``networks`` (networks as such a folder) and ``command``
(the verb, for releases too: ``rema_data.publish``).
"""
