"""Maps of success: what a network says of every place and angle of some scenes.

The scene is encoded once for all angles, an end effector once for all scenes that it meets; bare hands, which most
steps have, keep their kernels. Hands that look the same turned by half, as bare ones do, are scored at half of the
angles. Batch normalisation is folded into the convolutions. All of it gives the same numbers up to rounding.
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
from rema_data.grid import ANGLES, SCENE_PIXELS

__all__ = ["Scorer"]

_PAIRS = 8
"""Scenes and angles that are decoded at a time: what is computed meanwhile fits the processor's caches."""
_KEPT_HANDS = 8
"""End effectors whose kernels are kept."""


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
        self._device = torch.device("cpu" if device == OPENVINO else device)
        placed = folded(network).placed(self._device)
        self._network = compiled(placed) if device == OPENVINO else placed
        self._kernels: OrderedDict[tuple[bytes, int], Tensor] = OrderedDict()

    @torch.inference_mode()
    def log_odds(
        self, scene: npt.NDArray[np.float32], end_effector: npt.NDArray[np.float32], angles: int
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

        Returns
        -------
        float32 (N, 64, 64, angles)
        """
        count = len(scene)
        scenes = torch.from_numpy(np.ascontiguousarray(scene)).to(self._device)[:, None]
        features = self._network.encode_scene(scenes.contiguous(memory_format=torch.channels_last))
        scores = torch.empty((count, angles, SCENE_PIXELS, SCENE_PIXELS), device=self._device)
        for members, hand in _groups(end_effector):
            half = ANGLES // 2
            distinct = half if angles == ANGLES and np.array_equal(hand, hand[::-1, ::-1]) else angles
            kernels = self._kernels_of(hand, distinct)
            for n in members:
                for first in range(0, distinct, _PAIRS):
                    part = kernels[first : first + _PAIRS]
                    logits = self._network.decode(features[n : n + 1].expand(len(part), -1, -1, -1), part)
                    scores[n, first : first + _PAIRS] = logits[:, 1] - logits[:, 0]
                if distinct < angles:
                    scores[n, half:] = scores[n, :half]
        result: npt.NDArray[np.float32] = scores.movedim(1, -1).cpu().numpy()
        return result

    def _kernels_of(self, hand: npt.NDArray[np.float32], angles: int) -> Tensor:
        """Kernels of one end effector at the first angles, float32 (angles, C, S, S)."""
        key = (hashlib.sha256(np.ascontiguousarray(hand).data).digest(), angles)
        if key not in self._kernels:
            planes = torch.from_numpy(np.ascontiguousarray(np.moveaxis(hand, -1, 0))).to(self._device)
            turned = turn_end_effector(planes.expand(angles, -1, -1, -1), torch.arange(angles, device=self._device))
            turned = turned.contiguous(memory_format=torch.channels_last)
            parts = [self._network.encode_end_effector(piece) for piece in torch.split(turned, _PAIRS)]
            self._kernels[key] = torch.cat(parts)
            if len(self._kernels) > _KEPT_HANDS:
                self._kernels.popitem(last=False)
        self._kernels.move_to_end(key)
        return self._kernels[key]


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
