"""A learned policy in PyTorch: a small network judges every action near the object, and the best one is taken.

    python examples/train.py --output weights.safetensors
    rema evaluate examples/torch_policy.py --checkpoint weights.safetensors --task grasp --episodes 200

It sees the scene alone, not what the hand holds: it is for the bare hand, so for the tasks grasp and push.
"""

from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from patches import POINTS, candidates, features
from safetensors.torch import load_file
from torch import Tensor, nn

from evaluator.policy import ObservationBatch


class Network(nn.Module):
    """Features of actions, float32 (N, 171), to a logit of success each; one network for every primitive."""

    def __init__(self, width: int = 128) -> None:
        super().__init__()
        self.of = nn.ModuleDict({primitive: self._layers(width) for primitive in ("grasp", "push")})

    @staticmethod
    def _layers(width: int) -> nn.Module:
        first = nn.Linear(POINTS * POINTS + 2, width)
        return nn.Sequential(first, nn.ReLU(), nn.Linear(width, width), nn.ReLU(), nn.Linear(width, 1), nn.Flatten(0))

    def forward(self, features: Tensor, primitive: str) -> Tensor:
        logits: Tensor = self.of[primitive](torch.cat([features[:, :-2] * 30, features[:, -2:]], 1))  # 3 cm to about 1
        return logits


class Policy:
    def __init__(self, checkpoint: Path | None, device: str) -> None:
        if checkpoint is None:
            raise ValueError("no weights: python examples/train.py makes them, and --checkpoint names them")
        self.device = device
        self.network = Network().to(device).eval()
        self.network.load_state_dict(load_file(checkpoint, device=device))

    @torch.inference_mode()
    def act(self, observations: ObservationBatch) -> NDArray[Any]:
        """The action (i, j, k) with the largest logit, for every observation."""
        actions = []
        for scene, valid in zip(observations.scene, observations.valid, strict=True):
            i, j, k = candidates(scene, valid, observations.primitive)
            seen = torch.from_numpy(features(scene, i, j, k, observations.primitive)).to(self.device)
            best = int(self.network(seen, observations.primitive).argmax())
            actions.append((i[best], j[best], k[best]))
        return np.array(actions)
