"""``features.json`` of an RLDS export, as TensorFlow Datasets reads it."""

from __future__ import annotations

from typing import Any

from rema_data.convert.base import Maps
from rema_data.convert.layout import obs_dtype
from rema_data.grid import EE_PIXELS, SCENE_PIXELS
from rema_data.store.columns import EPISODE_COLUMNS, VARIATION, columns_at

__all__ = ["EPISODE_VALUES", "MAPS", "VERSION", "episode_texts", "features"]

VERSION = "1.0.0"
"""Of the dataset, for TensorFlow Datasets."""
MAPS = {"scene": (SCENE_PIXELS, SCENE_PIXELS, 1), "end_effector": (EE_PIXELS, EE_PIXELS, 4)}
_EPISODE_TEXTS = ("split", "seed", "failure", VARIATION)
"""Columns of ``episodes.parquet`` in ``episode_metadata`` as text; a root seed may be too large for an int64."""
EPISODE_VALUES = ("round", "episode", "success", "failed_step")
"""Columns as numbers; no failed step is -1."""

_CORE = "tensorflow_datasets.core.features"


def episode_texts(version: int) -> list[str]:
    """Columns of an episode as text, in a schema version; null is empty."""
    known = {column.name for column in columns_at(EPISODE_COLUMNS, version)}
    return [name for name in _EPISODE_TEXTS if name in known]


def features(maps: Maps, version: int) -> dict[str, Any]:
    """The features of an episode of a release in a schema version."""
    steps = {
        "observation": _dict({name: _tensor(shape, obs_dtype(maps), "zlib") for name, shape in MAPS.items()}),
        "action": _tensor((4,), "float32"),
        "grid_index": _scalar("int64"),
        "reward": _scalar("float32"),
        "discount": _scalar("float32"),
        **{name: _scalar("bool") for name in ("is_first", "is_last", "is_terminal")},
        **{name: _text() for name in ("language_instruction", "primitive", "embodiment", "policy", "failure")},
    }
    episode = {name: _text() for name in episode_texts(version)}
    episode |= {name: _scalar("bool" if name == "success" else "int64") for name in EPISODE_VALUES}
    sequence = {"sequence": {"feature": _dict(steps), "length": "-1"}}
    return _dict(
        {
            "steps": {"pythonClassName": f"{_CORE}.dataset_feature.Dataset", **sequence},
            "episode_metadata": _dict(episode),
        }
    )


def _dict(members: dict[str, Any]) -> dict[str, Any]:
    return {"pythonClassName": f"{_CORE}.features_dict.FeaturesDict", "featuresDict": {"features": members}}


def _tensor(shape: tuple[int, ...], dtype: str, encoding: str = "none") -> dict[str, Any]:
    about = {"shape": {"dimensions": [str(size) for size in shape]}, "dtype": dtype, "encoding": encoding}
    return {"pythonClassName": f"{_CORE}.tensor_feature.Tensor", "tensor": about}


def _scalar(dtype: str) -> dict[str, Any]:
    about = {"shape": {}, "dtype": dtype, "encoding": "none"}
    return {"pythonClassName": f"{_CORE}.scalar.Scalar", "tensor": about}


def _text() -> dict[str, Any]:
    return {"pythonClassName": f"{_CORE}.text_feature.Text", "text": {}}
