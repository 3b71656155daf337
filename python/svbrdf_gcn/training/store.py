"""safetensors files: named tensors behind a JSON header, with checksums (docs/weights.md)."""

import torch

from . import checksums

TYPES = {"F16": torch.float16, "F32": torch.float32, "F64": torch.float64}
NAMES = {dtype: name for name, dtype in TYPES.items()}


def save(path, tensors, metadata=None):
    """Write `tensors` (a dictionary of names to float tensors) whole or not at all."""
    header, offset, blobs = {}, 0, {}
    for name in sorted(tensors):
        tensor = tensors[name].detach().cpu().contiguous()
        blob = tensor.numpy().tobytes()
        header[name] = {"dtype": NAMES[tensor.dtype], "shape": list(tensor.shape), "data_offsets": [offset, offset + len(blob)]}
        offset += len(blob)
        blobs[name] = blob
    metadata = {key: str(value) for key, value in (metadata or {}).items()}
    checksums.write(path, header, checksums.added(metadata, blobs), b"".join(blobs.values()))


def load(path):
    """The tensors of a file and its metadata; SystemExit if it is damaged."""
    try:
        header, metadata, blobs, _ = checksums.read(path)
        checksums.verify(metadata, blobs)
    except checksums.ChecksumError as error:
        raise SystemExit(f"{path}: {error}") from None
    tensors = {}
    for name, entry in header.items():
        blob = bytearray(blobs[name])
        values = torch.frombuffer(blob, dtype=TYPES[entry["dtype"]]) if blob else torch.empty(0)
        tensors[name] = values.reshape(entry["shape"])
    return tensors, metadata
