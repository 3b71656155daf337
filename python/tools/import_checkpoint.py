#!/usr/bin/env python3
"""Turns the checkpoints that the paper's authors released into a weights file of svbrdf-gcn.

    import_checkpoint.py OUT.safetensors --pair enc_4.ckpt dec_4.ckpt --pair enc_1.ckpt dec_1.ckpt

A checkpoint is a zip archive with a pickle in it. Pickles can run code; this script executes none: the only names a pickle may
mention are those of tensors, float storages and dictionaries, and all three are stand-ins defined here.
Needs Python 3.9 and numpy. The weights keep the licence their authors gave them: state it with --license.
"""

import argparse
import json
import pickle
import sys
import zipfile
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[1] / "svbrdf_gcn" / "training"))

import checksums  # noqa: E402

# What the reader of weights files demands; see Model::load.
CONVENTIONS = {
    "format": "svbrdf-gcn weights",
    "version": checksums.VERSION,
    "brdf": "paper",
    "roughness": "perceptual",
    "color_space": "photos gamma2.2, albedos gamma2.2 of [-1, 1]",
}
CHANNELS = {
    "isotropic": "diffuse 3, normal 2, roughness 1, specular 3",
    "anisotropic": "diffuse 3, normal 3, roughness 2, specular 3, tangent 3",
}
DTYPES = {"FloatStorage": "<f4", "HalfStorage": "<f2", "DoubleStorage": "<f8"}
# Longest pickle accepted; those of the released files have some 70 kB.
MAX_PICKLE = 16 << 20


class CheckpointError(Exception):
    """A file that is not a checkpoint of this network, or a hostile one."""


class Dictionary(dict):
    """Stands in for collections.OrderedDict."""


class StorageType:
    """Stands in for torch.FloatStorage and its like."""

    __slots__ = ("dtype",)

    def __init__(self, dtype):
        self.dtype = dtype


class Storage:
    """The place of a tensor's values in the archive."""

    __slots__ = ("dtype", "key", "count")

    def __init__(self, dtype, key, count):
        self.dtype, self.key, self.count = dtype, key, count


class Tensor:
    """A tensor whose values have not been read yet."""

    __slots__ = ("storage", "offset", "shape", "strides")

    def __init__(self, storage, offset, shape, strides):
        self.storage, self.offset, self.shape, self.strides = storage, offset, shape, strides


def is_count(value):
    return type(value) is int and 0 <= value < 1 << 48


def rebuild_tensor(storage, offset, shape, strides, *_):
    """Stands in for torch._utils._rebuild_tensor_v2."""
    if not isinstance(storage, Storage) or not is_count(offset) or type(shape) is not tuple or type(strides) is not tuple:
        raise CheckpointError("a tensor is described by values of the wrong type")
    if len(shape) != len(strides) or len(shape) > 8 or not all(map(is_count, shape + strides)):
        raise CheckpointError(f"a tensor has shape {shape!r:.100} and strides {strides!r:.100}")
    return Tensor(storage, offset, shape, strides)


def rebuild_parameter(data, *_):
    """Stands in for torch._utils._rebuild_parameter."""
    if not isinstance(data, Tensor):
        raise CheckpointError("a parameter is not made from a tensor")
    return data


class Unpickler(pickle.Unpickler):
    """A reader of pickles that knows tensors and dictionaries and nothing else."""

    ALLOWED = {
        ("collections", "OrderedDict"): Dictionary,
        ("torch._utils", "_rebuild_tensor_v2"): rebuild_tensor,
        ("torch._utils", "_rebuild_parameter"): rebuild_parameter,
        **{("torch", name): StorageType(dtype) for name, dtype in DTYPES.items()},
    }

    def find_class(self, module, name):
        try:
            return self.ALLOWED[module, name]
        except (KeyError, TypeError):
            raise CheckpointError(f"the pickle wants {module!s:.100}.{name!s:.100}, which a checkpoint has no use for") from None

    def persistent_load(self, pid):
        if type(pid) is tuple and len(pid) == 5 and pid[0] == "storage":
            _, kind, key, _, count = pid
            if isinstance(kind, StorageType) and type(key) is str and is_count(count):
                return Storage(kind.dtype, key, count)
        raise CheckpointError(f"the pickle refers to {pid!r:.100}, which is no storage")


def read_tensor(archive, folder, name, tensor):
    """The values of a tensor as float32, checked against the archive."""
    storage = tensor.storage
    try:
        entry = archive.getinfo(f"{folder}data/{storage.key}")
    except KeyError:
        raise CheckpointError(f"{name}: storage {storage.key!r:.100} is missing") from None
    if entry.compress_type != zipfile.ZIP_STORED or entry.file_size != storage.count * np.dtype(storage.dtype).itemsize:
        raise CheckpointError(f"{name}: expected {storage.count} stored values of {storage.dtype}, got {entry.file_size} bytes")
    values = np.frombuffer(archive.read(entry), storage.dtype)
    count = 1
    for side in tensor.shape:
        count *= side
    last = tensor.offset + sum((side - 1) * stride for side, stride in zip(tensor.shape, tensor.strides))
    if count == 0 or count > len(values) or last >= len(values):
        raise CheckpointError(f"{name}: shape {tensor.shape} does not fit into {len(values)} values")
    strides = [stride * values.itemsize for stride in tensor.strides]
    view = np.lib.stride_tricks.as_strided(values[tensor.offset :], tensor.shape, strides, writeable=False)
    result = np.array(view, dtype="<f4", order="C")
    if not np.isfinite(result).all():
        raise CheckpointError(f"{name}: not all values are finite")
    return result


def read_checkpoint(path):
    """The tensors of a checkpoint by name, without the prefix `module.`."""
    with open(path, "rb") as file:
        try:
            with zipfile.ZipFile(file) as archive:
                return read_archive(archive)
        except CheckpointError as error:
            raise CheckpointError(f"{path}: {error}") from None
        except Exception as error:  # a damaged archive can fail in any way
            raise CheckpointError(f"{path}: no readable zip archive: {type(error).__name__}: {error}") from None


def read_archive(archive):
    pickles = [entry for entry in archive.infolist() if entry.filename.split("/")[1:] == ["data.pkl"]]
    if len(pickles) != 1:
        raise CheckpointError(f"expected one data.pkl, got {len(pickles)}")
    entry = pickles[0]
    if entry.compress_type != zipfile.ZIP_STORED or entry.file_size > MAX_PICKLE:
        raise CheckpointError(f"data.pkl: expected at most {MAX_PICKLE} stored bytes, got {entry.file_size}")
    folder = entry.filename[: -len("data.pkl")]
    if f"{folder}byteorder" in archive.namelist() and archive.read(f"{folder}byteorder") != b"little":
        raise CheckpointError("byteorder: expected little")
    with archive.open(entry) as file:
        try:
            content = Unpickler(file).load()
        except CheckpointError:
            raise
        except Exception as error:  # a broken pickle can fail in any way
            raise CheckpointError(f"data.pkl: {type(error).__name__}: {error}") from None
    if not isinstance(content, dict):
        raise CheckpointError(f"data.pkl: expected a dictionary of tensors, got {type(content).__name__}")
    tensors = {}
    for name, tensor in content.items():
        if type(name) is not str or not isinstance(tensor, Tensor):
            raise CheckpointError(f"data.pkl: entry {name!r:.100} is no tensor")
        name = name.removeprefix("module.")
        tensors[name] = read_tensor(archive, folder, name, tensor)
    return tensors


def count_blocks(tensors, prefix):
    """How many numbered parts there are below `prefix`."""
    parts = {name[len(prefix) :].split(".")[0] for name in tensors if name.startswith(prefix)}
    if parts != {str(index) for index in range(len(parts))}:
        raise CheckpointError(f"{prefix}: parts are not numbered from 0 without gaps: {sorted(parts)}")
    return len(parts)


def configuration(encoder, decoder, gcn, roughness_floor):
    """Sizes and form of a network, from its tensors."""
    levels = count_blocks(encoder, "downs.")
    if "intro.weight" in encoder:
        width, photos, gcn = encoder["intro.weight"].shape[0], encoder["intro.weight"].shape[1] // 3, "none"
    elif "conv0.weight" in encoder and "adj1" in encoder:
        width = encoder["adj1"].shape[0]
        photos = width // max(encoder["conv0.weight"].shape[0], 1)
    else:
        raise CheckpointError("the encoder has neither intro.weight nor conv0.weight and adj1")
    return {
        "photos": photos,
        "width": width,
        "encoder_blocks": [count_blocks(encoder, f"encoders.{level}.") for level in range(levels)],
        "middle_blocks": count_blocks(decoder, "middle_blks."),
        "decoder_blocks": [count_blocks(decoder, f"decoders.{level}.") for level in range(levels)],
        "gcn": gcn,
        "lobe": "anisotropic" if "tang_conv.end.weight" in decoder else "isotropic",
        "roughness_floor": roughness_floor,
    }


def write_weights(path, networks, license_text):
    """Writes `networks`, pairs of a configuration and tensors by name, into one safetensors file."""
    lobes = {config["lobe"] for config, _ in networks}
    if len(lobes) != 1 or len({config["photos"] for config, _ in networks}) != len(networks):
        raise CheckpointError("the networks of a file are for different numbers of photos, and all isotropic or all anisotropic")
    metadata = dict(CONVENTIONS, license=license_text, channels=CHANNELS[lobes.pop()])
    metadata["networks"] = json.dumps([config for config, _ in networks])
    header, blobs, end = {}, {}, 0
    for config, tensors in networks:
        for name, values in tensors.items():
            start, end = end, end + values.nbytes
            name = f"photos{config['photos']}.{name}"
            header[name] = {"dtype": "F32", "shape": values.shape, "data_offsets": [start, end]}
            blobs[name] = values.tobytes()
    checksums.write(path, header, checksums.added(metadata, blobs), b"".join(blobs.values()))


def import_pair(encoder_path, decoder_path, gcn="diagonal", roughness_floor=-0.3):
    """Configuration and tensors of one network."""
    encoder, decoder = read_checkpoint(encoder_path), read_checkpoint(decoder_path)
    config = configuration(encoder, decoder, gcn, roughness_floor)
    # The encoders carry a convolution named `ending` that nothing uses.
    tensors = {f"encoder.{name}": values for name, values in encoder.items() if not name.startswith("ending.")}
    tensors.update((f"decoder.{name}", values) for name, values in decoder.items())
    return config, tensors


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", help="weights file to write")
    parser.add_argument("--pair", nargs=2, action="append", required=True, metavar=("ENC", "DEC"), help="checkpoints of one network")
    parser.add_argument("--gcn", choices=["diagonal", "full"], default="diagonal", help="graph convolution the weights were trained with")
    parser.add_argument("--roughness-floor", type=float, default=-0.3, help="raw roughness is clamped from below at this")
    parser.add_argument("--license", default="as stated by the authors of the checkpoints", help="licence of the weights")
    options = parser.parse_args(arguments)
    try:
        networks = [import_pair(*pair, options.gcn, options.roughness_floor) for pair in options.pair]
        write_weights(options.out, networks, options.license)
    except (CheckpointError, OSError) as error:
        sys.exit(f"import_checkpoint: {error}")


if __name__ == "__main__":
    main()
