"""The three parts of a network, compiled by OpenVINO: the same float32 sums in another order, sooner on a CPU."""

from __future__ import annotations

import copy
import warnings

import torch
from torch import Tensor, nn

from baselines.tae.network import TaeNetwork
from rema_data.errors import InputError
from rema_data.grid import EE_PIXELS, SCENE_PIXELS

__all__ = ["OPENVINO", "compiled"]

OPENVINO = "openvino"
"""The name of this way to compute, where a device is asked for."""


def compiled(network: TaeNetwork) -> TaeNetwork:
    """A copy for inference whose encoders and decoder run in OpenVINO, on as many threads as torch has.

    Parameters
    ----------
    network : TaeNetwork
        In evaluation mode.

    Raises
    ------
    InputError
        OpenVINO is not installed.
    """
    made = copy.deepcopy(network)
    cells, channels = SCENE_PIXELS // network.architecture.scene_stride, network.architecture.width // 4
    made.scene_encoder = _Compiled(network.scene_encoder, (1, SCENE_PIXELS, SCENE_PIXELS))
    made.ee_encoder = _Compiled(network.ee_encoder, (4, EE_PIXELS, EE_PIXELS))
    made.decoder = _Compiled(network.decoder, (channels, cells, cells))
    return made


class _Compiled(nn.Sequential):
    """One part, for batches of any size of inputs of one shape."""

    def __init__(self, part: nn.Module, shape: tuple[int, int, int]) -> None:
        super().__init__()
        try:
            import openvino
        except ImportError as error:
            raise InputError(
                "OpenVINO is not installed, and the device asked for it", hint='pip install "rema[openvino]"'
            ) from error
        with warnings.catch_warnings(action="ignore"):  # that it uses what torch calls deprecated is not the user's
            model = openvino.convert_model(part, example_input=torch.zeros(2, *shape), input=[-1, *shape])
        # Half of the bits would be faster than all on some processors, and take other decisions.
        options = {"INFERENCE_PRECISION_HINT": "f32", "INFERENCE_NUM_THREADS": torch.get_num_threads()}
        self._request = openvino.compile_model(model, "CPU", options).create_infer_request()

    def forward(self, x: Tensor) -> Tensor:
        return torch.from_numpy(self._request.infer([x.contiguous().numpy()])[0].copy())
