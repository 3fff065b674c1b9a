"""How a hostile policy ends: whether it gained anything, and whether what it did is counted."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from evaluator.policy import Answer, PolicyFault, PolicyHost, PolicyLimits, resolve
from rema_data import grid
from tests.evaluator.policy.batches import make_batch, make_situation
from tests.evaluator.policy.hostile import every

PATIENT = PolicyLimits(start_s=120, batch_s=60, single_s=60)
SMALL = PolicyLimits(
    start_s=120, batch_s=60, memory_bytes=400 << 20, disk_bytes=48 << 20, disk_files=100, tasks=64, open_files=256
)
SHORT = replace(SMALL, batch_s=1.0, observation_s=0.1, single_s=1.0)
_LIMITS = {
    "Stops": SHORT,
    "HoldsInterpreter": SHORT,
    "FloodsLog": SHORT,
    "Dawdles": PolicyLimits(start_s=60, batch_s=30, run_s=1.5, observation_s=0.01),
    "Erratic": PolicyLimits(start_s=60, batch_s=10, single_s=5),
}


@dataclass(frozen=True, slots=True)
class Verdict:
    """The end of one hostile policy."""

    contained: bool  # it gained nothing
    counted: bool  # and every question has an answer or a fault
    found: str  # what happened, in words


def successes(answer: Answer) -> int:
    """The tries that a policy says succeeded; -1 for a fault."""
    return -1 if isinstance(answer, PolicyFault) else int(grid.decode(int(answer))[2])


def verdict(name: str, folder: Path) -> Verdict:
    """Ask a hostile policy, in a process of its own; ``folder`` is for its weights."""
    kind = every.POLICIES[name].ends
    weights = folder / "weights.npz"
    weights.write_bytes(b"")
    with PolicyHost(resolve(every.place(name)), weights, "cpu", _limits(name)) as host:
        ask = {"denied": _denied, "fault": _fault, "differ": _differ}[kind]
        found = ask(name, host)
    return replace(found, contained=found.contained and weights.read_bytes() == b"")


def _limits(name: str) -> PolicyLimits:
    return _LIMITS.get(name, SMALL if every.POLICIES[name].__module__.endswith("taking") else PATIENT)


def _denied(name: str, host: PolicyHost) -> Verdict:
    answers = host.act(make_batch(2))
    most = max(map(successes, answers))
    whole = len(answers) == 2 and min(map(successes, answers)) >= 0
    gained = max(0, most - every.POLICIES[name].harmless)
    return Verdict(whole and not gained, whole, f"{gained} of its tries gained anything")


def _fault(name: str, host: PolicyHost) -> Verdict:
    asked = {"Dawdles": [1] * 8, "Erratic": [64]}.get(name, [1])
    answers: list[Answer] = []
    for count in asked:
        answers += host.act(make_batch(count), (make_situation(),) * count)
    faults = [one for one in answers if isinstance(one, PolicyFault)]
    found = f"{len(faults)} of {len(answers)} are faults" + (f": {faults[-1].detail}" if faults else "")
    return Verdict(not host.privileged, len(answers) == sum(asked) and bool(faults), found)


def _differ(name: str, host: PolicyHost) -> Verdict:
    """It may remember; the same question, asked again in another order by another process, shows it."""
    batch = make_batch(4)
    first, again = host.act(batch), host.act(batch)
    with PolicyHost(host.spec, None, "cpu", PATIENT) as other:
        backwards = [other.act(batch.one(n))[0] for n in reversed(range(4))][::-1]
    differed = sum(one != two for one, two in zip(first, again, strict=True))
    differed += sum(one != two for one, two in zip(first, backwards, strict=True))
    return Verdict(differed > 0, len(first) == 4, f"{differed} of 8 repeated answers differed")
