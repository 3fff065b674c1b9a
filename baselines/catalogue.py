"""The built-in policies by name: what the entry points of the group ``rema.policies`` lead to. Imports no policy."""

from __future__ import annotations

from pathlib import Path

from evaluator.policy.named import NamedPolicy

__all__ = ["RANDOM", "REFERENCE", "SCRIPTED", "TAE", "TAE_JOINT", "TAE_SEPARATE"]

_HERE = Path(__file__).resolve().parent

RANDOM = NamedPolicy(
    _HERE / "random_policy.py", "RandomPolicy", "random", "Uniform over the valid actions.", published="random"
)
SCRIPTED = NamedPolicy(
    _HERE / "scripted_policy.py",
    "ScriptedPolicy",
    "privileged",
    "The target's true position, a uniform angle.",
    published="scripted",
)
REFERENCE = NamedPolicy(
    _HERE / "reference_policy.py", "ReferencePolicy", "reference", "Well-placed grasps of objects that it knows."
)
TAE = NamedPolicy(_HERE / "tae_policy.py", "TaePolicy", "learned", "Your own networks: needs --checkpoint.")
TAE_JOINT = NamedPolicy(
    TAE.file, TAE.class_name, "learned", "Two networks, shared by the skills of a primitive.", published="joint"
)
TAE_SEPARATE = NamedPolicy(TAE.file, TAE.class_name, "learned", "One network for every skill.", published="separate")
