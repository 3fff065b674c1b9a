"""The kinds of steps (paper, section 4.2): one object each, that answers all questions about it.

A new kind is a module here, an entry in ``KINDS``, and its place in the table of tasks (``rema_data.schema``).
"""

from evaluator.sim.kinds.base import Kind
from evaluator.sim.kinds.grasp import Grasp
from evaluator.sim.kinds.pincer import Pincer
from evaluator.sim.kinds.pinched_push import PinchedPush
from evaluator.sim.kinds.push import Push
from evaluator.sim.kinds.tool_push import ToolPush
from rema_data.schema import Situation, StepKind

__all__ = ["KINDS", "Kind", "kind_of"]

KINDS: dict[StepKind, Kind] = {kind.step: kind for kind in (Grasp(), Push(), ToolPush(), Pincer(), PinchedPush())}
"""The object of every kind of step."""


def kind_of(situation: Situation) -> Kind:
    """The kind of the step that a situation starts."""
    return KINDS[situation.kind]
