"""Play a finished run again from its recorded actions: no policy, no weights, no torch.

Two things are checked: that what lies in the folder is what was sealed (``evaluator.run``), and that it is true, by
simulating the recorded actions again and by counting the rows again.
"""

from __future__ import annotations

from evaluator.replay.play import replay
from evaluator.replay.report import ReplayReport

__all__ = ["ReplayReport", "replay"]
