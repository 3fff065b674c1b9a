"""Every process of the tests computes with one thread: several run at a time, and the networks are small.

No example of a property test has a deadline: how long it takes says something about the machine, not about the code.
There are 60 of them a run, and other ones in every run.
"""

from __future__ import annotations

import os
import signal

from hypothesis import settings

for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

# A shell has the processes that it starts in the background ignore Ctrl-C, and they hand that on to theirs.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

settings.register_profile("rema", max_examples=60, deadline=None)
settings.load_profile("rema")
