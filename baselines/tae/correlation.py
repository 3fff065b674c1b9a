"""Cross-convolution: every channel of a scene's features is correlated with the same channel of a kernel."""

from __future__ import annotations

from torch import Tensor
from torch.nn import functional

__all__ = ["cross_convolve"]


def cross_convolve(features: Tensor, kernels: Tensor) -> Tensor:
    """Correlate each sample's features with its own kernel, channel by channel, as one grouped convolution.

    Parameters
    ----------
    features : Tensor (N, C, H, W)
    kernels : Tensor (N, C, S, S)

    Returns
    -------
    Tensor (N, C, H, W)
        At (i, j) the kernel's cell (S // 2, S // 2) lies on the feature cell (i, j); outside of the map is zero.
    """
    count, channels, height, width = features.shape
    size = kernels.shape[-1]
    # An even kernel has no middle cell: one row and one column more of padding before than after.
    before, after = size // 2, (size - 1) // 2
    padded = functional.pad(features, (before, after, before, after))
    stacked = padded.reshape(1, count * channels, height + size - 1, width + size - 1)
    filters = kernels.reshape(count * channels, 1, size, size)
    return functional.conv2d(stacked, filters, groups=count * channels).view(count, channels, height, width)
