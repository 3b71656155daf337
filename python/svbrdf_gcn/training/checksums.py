#!/usr/bin/env python3
"""Gives a weights file its checksums, or verifies those that it has: checksums.py FILE...

What the metadata entry `checksums` holds is described in docs/weights.md. No weight is changed. Needs Python 3.9 and nothing else.
"""

import argparse
import json
import math
import os
import struct
import sys
import zlib

# Weights of this version have checksums, those of version 1 have none.
VERSION = "2"
ENTRY = "checksums"
# Bytes of a value.
SIZES = {"F16": 2, "F32": 4, "F64": 8}


class ChecksumError(Exception):
    """A file that is damaged, or not a safetensors file."""


def crc32(*parts):
    """CRC-32 of bytes, as eight hexadecimal digits."""
    value = 0
    for part in parts:
        value = zlib.crc32(part, value)
    return f"{value:08x}"


def of_metadata(metadata):
    """The checksum of all entries but `checksums`, in the order of their keys: key, NUL, value, NUL."""
    entries = sorted((key, value) for key, value in metadata.items() if key != ENTRY)
    return crc32(*(f"{text}\0".encode() for entry in entries for text in entry))


def added(metadata, blobs):
    """`metadata` with checksums of itself and of `blobs`, the bytes of each tensor by its name."""
    sums = {"metadata": of_metadata(metadata), "tensors": {name: crc32(blob) for name, blob in blobs.items()}}
    return {**metadata, ENTRY: json.dumps(sums)}


def verify(metadata, blobs):
    """Fail unless the checksums are right; whether there are any."""
    if ENTRY not in metadata:
        return False
    try:
        sums = json.loads(metadata[ENTRY])
        expected = {"the metadata": sums["metadata"], **{f"tensor {name}": value for name, value in sums["tensors"].items()}}
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise ChecksumError(f"metadata entry {ENTRY!r}: {error}") from None
    got = {"the metadata": of_metadata(metadata), **{f"tensor {name}": crc32(blob) for name, blob in blobs.items()}}
    for what in {**expected, **got}:
        if expected.get(what) != got.get(what):
            raise ChecksumError(f"{what}: the checksum is {got.get(what)}, the file states {expected.get(what)}: it is damaged")
    return True


def read(path):
    """The header of a safetensors file, its metadata and the bytes of each tensor."""
    with open(path, "rb") as file:
        content = file.read()
    try:
        (length,) = struct.unpack_from("<Q", content)
        if length > len(content) - 8:
            raise ValueError(f"a header of {length} bytes in a file of {len(content)}")
        header = json.loads(content[8 : 8 + length])
        metadata = header.pop("__metadata__", {})
        data = memoryview(content)[8 + length :]
        check_places(header, len(data))
    except (struct.error, ValueError, KeyError, TypeError, AttributeError) as error:
        raise ChecksumError(f"not a safetensors file, or a damaged one: {error}") from None
    return header, metadata, {name: data[slice(*entry["data_offsets"])] for name, entry in header.items()}, data


def check_places(header, length):
    """Fail unless the tensors fill `length` bytes one after the other, as many bytes each as its shape needs."""
    if not header:
        raise ValueError("it holds no tensors")
    end = 0
    for name, entry in sorted(header.items(), key=lambda item: item[1]["data_offsets"]):
        start, stop = entry["data_offsets"]
        if start != end or stop - start != SIZES[entry["dtype"]] * math.prod(entry["shape"]):
            raise ValueError(f"tensor {name}: {entry['dtype']} of shape {entry['shape']} at {start} to {stop}, expected it from {end} on")
        end = stop
    if end != length:
        raise ValueError(f"tensors of {end} bytes in all, got {length}")


def write(path, header, metadata, data):
    """Write a safetensors file whole or not at all."""
    text = json.dumps({"__metadata__": metadata, **header}).encode()
    text += b" " * (-len(text) % 8)
    temporary = f"{path}.part"
    with open(temporary, "wb") as file:
        file.write(struct.pack("<Q", len(text)) + text)
        file.write(data)
    os.replace(temporary, path)


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="+", metavar="FILE", help="weights file; one without checksums is replaced by one with them")
    for path in parser.parse_args(arguments).files:
        try:
            header, metadata, blobs, data = read(path)
            if verify(metadata, blobs):
                print(f"{path}: {len(blobs)} tensors and the metadata are as they were written")
                continue
            write(path, header, added({**metadata, "version": VERSION}, blobs), data)
            print(f"{path}: checksums of {len(blobs)} tensors and the metadata added")
        except (ChecksumError, OSError) as error:
            sys.exit(f"checksums: {path}: {error}")


if __name__ == "__main__":
    main()
