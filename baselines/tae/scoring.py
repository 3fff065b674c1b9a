"""Maps of success: what a network says of every place and angle of some scenes.

The scene is encoded once for all angles, an end effector once for all scenes that it meets; bare hands, which most
steps have, keep their kernels; of other maps only the part that is not empty is encoded. Hands that look the same
turned by half, as bare ones do, are scored at half of the angles. Batch normalisation is folded into the convolutions.
All of it gives the same numbers up to rounding.

Where only the best action is wanted, and the processor multiplies matrices of bfloat16, a first look in these decides
which angles can have it: about two of sixteen. Only they are scored in float32, so the answer is that of float32.
"""

from __future__ import annotations

import copy
import hashlib
from collections import OrderedDict

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from baselines.tae.network import TaeNetwork
from baselines.tae.openvino import OPENVINO, compiled
from baselines.tae.rotation import turn_end_effector
from baselines.tae.windows import WindowedEncoder
from rema_data.grid import ANGLES, SCENE_PIXELS

__all__ = ["Scorer", "multiplies_bfloat16"]

_PAIRS = 8
"""Scenes and angles that are decoded at a time: what is computed meanwhile fits the processor's caches."""
_KEPT_HANDS = 8
"""End effectors whose kernels are kept."""
_MARGIN, _RELATIVE_MARGIN = 0.25, 1 / 64
"""How far in log odds an angle may lie below the best one at the first look, absolutely and as a share of the best.

`benchmarks/infer.py` measures the errors of bfloat16: a small part of it."""


class Scorer:
    """Scores scenes with one network.

    Parameters
    ----------
    network : TaeNetwork
        Left as it is.
    device : str
        Of torch; or ``openvino``: the processor, through OpenVINO.

    Raises
    ------
    InputError
        OpenVINO is asked for and not installed.
    """

    def __init__(self, network: TaeNetwork, device: str = "cpu") -> None:
        where = torch.device("cpu" if device == OPENVINO else device)
        placed = folded(network).placed(where)
        # One kernel at a time: it must not depend on which others are computed with it.
        exact = compiled(placed) if device == OPENVINO else placed
        self._exact = _Part(exact, where, torch.float32, 1, windows=placed is exact and where.type == "cpu")
        self._rough = None
        if where.type == "cpu" and multiplies_bfloat16():
            self._rough = _Part(copy.deepcopy(placed).to(torch.bfloat16), where, torch.bfloat16, _PAIRS, windows=True)

    def log_odds(
        self,
        scene: npt.NDArray[np.float32],
        end_effector: npt.NDArray[np.float32],
        angles: int,
        valid: npt.NDArray[np.bool_] | None = None,
    ) -> npt.NDArray[np.float32]:
        """Log odds of success of every action: the logit of success less that of failure.

        Parameters
        ----------
        scene : float32 (N, 64, 64)
            Metres.
        end_effector : float32 (N, 112, 112, 4)
            As in ``ObservationBatch``. Equal ones are encoded once.
        angles : int
            The first so many angles: 16, or 8 for two hands.
        valid : bool (N, 64, 64, >= angles), optional
            Where only the best of these actions is wanted: angles that cannot have it may be left out, as -inf.

        Returns
        -------
        float32 (N, 64, 64, angles)
        """
        scores = np.full((len(scene), angles, SCENE_PIXELS, SCENE_PIXELS), -np.inf, np.float32)
        half = ANGLES // 2
        for members, hand in _groups(end_effector):
            distinct = half if angles == ANGLES and np.array_equal(hand, hand[::-1, ::-1]) else angles
            for n in members:
                chosen = np.arange(distinct)
                if valid is not None and self._rough is not None:
                    allowed = np.moveaxis(valid[n, ..., :angles], -1, 0).reshape(-1, distinct, SCENE_PIXELS**2)
                    rough = self._rough.log_odds(scene[n], hand, chosen).reshape(distinct, -1)
                    best = np.where(allowed.any(axis=0), rough, -np.inf).max(axis=1)
                    chosen = np.flatnonzero(best >= best.max() - _MARGIN - _RELATIVE_MARGIN * abs(best.max()))
                scores[n, chosen] = self._exact.log_odds(scene[n], hand, chosen)
                if distinct < angles:
                    scores[n, half:] = scores[n, :half]
        return np.ascontiguousarray(np.moveaxis(scores, 1, -1))


class _Part:
    """A network that computes in one type of numbers, and the kernels of the last end effectors."""

    def __init__(
        self, network: TaeNetwork, device: torch.device, dtype: torch.dtype, at_once: int, *, windows: bool
    ) -> None:
        self._network, self._device, self._dtype, self._at_once = network, device, dtype, at_once
        self._encode = WindowedEncoder(network) if windows else self._encode_whole
        self._kernels: OrderedDict[bytes, dict[int, Tensor]] = OrderedDict()

    @torch.inference_mode()
    def log_odds(
        self, scene: npt.NDArray[np.float32], hand: npt.NDArray[np.float32], chosen: npt.NDArray[np.int64]
    ) -> npt.NDArray[np.float32]:
        """Log odds float32 (angles, 64, 64) of one scene with one end effector at some angles."""
        features = self._network.encode_scene(self._placed(scene[None, None]))
        kernels = self._kernels_of(hand, chosen)
        parts = [
            self._network.decode(features.expand(len(some), -1, -1, -1), some) for some in torch.split(kernels, _PAIRS)
        ]
        logits = torch.cat(parts).float()
        found: npt.NDArray[np.float32] = (logits[:, 1] - logits[:, 0]).cpu().numpy()
        return found

    def _kernels_of(self, hand: npt.NDArray[np.float32], chosen: npt.NDArray[np.int64]) -> Tensor:
        """Kernels of one end effector at some angles, (angles, C, S, S)."""
        key = hashlib.sha256(np.ascontiguousarray(hand).data).digest()
        kept = self._kernels.setdefault(key, {})
        self._kernels.move_to_end(key)
        if len(self._kernels) > _KEPT_HANDS:
            self._kernels.popitem(last=False)
        missing = [angle for angle in chosen.tolist() if angle not in kept]
        if missing:
            planes = self._placed(np.moveaxis(hand, -1, 0)[None], torch.float32)
            turned = turn_end_effector(planes.expand(len(missing), -1, -1, -1), torch.tensor(missing).to(planes.device))
            made = [self._encode(some) for some in torch.split(turned, self._at_once)]
            kept.update(zip(missing, torch.split(torch.cat(made), 1), strict=True))
        return torch.cat([kept[angle] for angle in chosen.tolist()])

    def _encode_whole(self, turned: Tensor) -> Tensor:
        return self._network.encode_end_effector(turned.to(self._dtype, memory_format=torch.channels_last))

    def _placed(self, maps: npt.NDArray[np.float32], dtype: torch.dtype | None = None) -> Tensor:
        tensor = torch.from_numpy(np.ascontiguousarray(maps)).to(self._device, dtype or self._dtype)
        return tensor.contiguous(memory_format=torch.channels_last)


def multiplies_bfloat16() -> bool:
    """Whether this processor multiplies matrices of bfloat16 (AMX, AVX-512 BF16), several times faster than float32."""
    instructions = ("_is_amx_tile_supported", "_is_avx512_bf16_supported")
    return any(getattr(torch.cpu, name, lambda: False)() for name in instructions)


def folded(network: TaeNetwork) -> TaeNetwork:
    """A copy in evaluation mode whose batch normalisations are folded into the convolutions before them."""
    made = copy.deepcopy(network).eval()
    for layers in [module for module in made.modules() if isinstance(module, nn.Sequential)]:
        for position in range(len(layers) - 1):
            conv, norm = layers[position], layers[position + 1]
            if isinstance(conv, nn.Conv2d) and isinstance(norm, nn.BatchNorm2d):
                layers[position], layers[position + 1] = fuse_conv_bn_eval(conv, norm), nn.Identity()
    return made


def _groups(end_effector: npt.NDArray[np.float32]) -> list[tuple[list[int], npt.NDArray[np.float32]]]:
    """Observations that share an end effector, with that end effector."""
    found: dict[bytes, tuple[list[int], npt.NDArray[np.float32]]] = {}
    if len(end_effector) > 1 and end_effector.strides[0] == 0:  # one map, shown for all
        return [(list(range(len(end_effector))), end_effector[0])]
    for n, hand in enumerate(end_effector):
        key = hashlib.sha256(np.ascontiguousarray(hand).data).digest()
        found.setdefault(key, ([], hand))[0].append(n)
    return list(found.values())
