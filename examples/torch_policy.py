"""A learned policy in PyTorch: a network marks every place and angle, the best valid one is the action.

    python examples/train.py --output weights.safetensors
    rema evaluate examples/torch_policy.py --checkpoint weights.safetensors --task grasp --episodes 200

The network sees the scene alone, not what is held: it is for the bare hand, tasks grasp and push. `baselines/tae` has a
network that sees the hand as well.
"""

from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors.torch import load_file
from torch import Tensor, nn

from evaluator.policy import ObservationBatch

PRIMITIVES = ["grasp", "push"]
YAWS = 8  # of the 16 angles: turned by half a turn, the bare hand is the same hand


class Network(nn.Module):
    """Scene, float32 (N, 1, 64, 64) in metres, to a logit of success for every primitive, row, column and yaw."""

    def __init__(self, width: int = 48) -> None:
        super().__init__()
        layers: list[nn.Module] = [nn.PixelUnshuffle(2), nn.Conv2d(4, width, 3, padding=1), nn.ReLU()]  # 9 mm a pixel
        for dilation in (1, 2, 4, 2, 1):  # sees 10 cm around a place
            layers += [nn.Conv2d(width, width, 3, padding=dilation, dilation=dilation), nn.ReLU()]
        layers += [nn.Conv2d(width, len(PRIMITIVES) * YAWS * 4, 1), nn.PixelShuffle(2)]  # back to 4.5 mm
        self.layers = nn.Sequential(*layers)

    def forward(self, scene: Tensor) -> Tensor:
        """Logits, float32 (N, 2, 64, 64, 8)."""
        logits = self.layers(scene * 20)  # objects are 2 to 5 cm high: to about 1
        return logits.unflatten(1, (len(PRIMITIVES), YAWS)).movedim(2, -1)


class Policy:
    def __init__(self, checkpoint: Path | None, device: str) -> None:
        if checkpoint is None:
            raise ValueError("give the weights: --checkpoint weights.safetensors, made by examples/train.py")
        self.device = device
        self.network = Network().to(device).eval()
        self.network.load_state_dict(load_file(checkpoint, device=device))

    @torch.inference_mode()
    def act(self, observations: ObservationBatch) -> NDArray[Any]:
        """The valid action with the largest logit, as a grid index, for every observation."""
        scene = torch.from_numpy(observations.scene)[:, None].to(self.device)
        logits = self.network(scene)[:, PRIMITIVES.index(observations.primitive)]
        every = logits.repeat(1, 1, 1, 2).cpu().numpy()  # 8 yaws, and the same half a turn further
        return np.where(observations.valid, every, -np.inf).reshape(len(every), -1).argmax(axis=1)
