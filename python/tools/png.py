"""Reads and writes PNG files of 8 or 16 bits, grey or RGB, with the standard library and numpy."""

import struct
import zlib
from pathlib import Path

import numpy as np

SIGNATURE = b"\x89PNG\r\n\x1a\n"
COLOR_TYPE = {1: 0, 3: 2}


def write(path, pixels):
    """Write `pixels`, shape (H, W, 1) or (H, W, 3), uint8 or uint16, row 0 at the top."""
    height, width, channels = pixels.shape
    depth = pixels.dtype.itemsize * 8
    if channels not in COLOR_TYPE or pixels.dtype not in (np.uint8, np.uint16):
        raise ValueError(f"pixels: expected 1 or 3 channels of uint8 or uint16, got {channels} of {pixels.dtype}")
    step = channels * depth // 8
    big_endian = pixels.astype(pixels.dtype.newbyteorder(">"))
    rows = np.frombuffer(big_endian.tobytes(), np.uint8).reshape(height, -1).astype(np.int32)
    lines = bytearray()
    above = np.zeros_like(rows[0])
    for row in rows:
        left, corner = (np.concatenate([np.zeros(step, np.int32), line[:-step]]) for line in (row, above))
        predictions = [0 * row, left, above, (left + above) // 2, paeth(left, above, corner)]
        residuals = [(row - prediction).astype(np.uint8) for prediction in predictions]
        best = min(range(5), key=lambda kind: np.abs(residuals[kind].view(np.int8).astype(np.int32)).sum())
        lines.append(best)
        lines += residuals[best].tobytes()
        above = row
    header = struct.pack(">IIBBBBB", width, height, depth, COLOR_TYPE[channels], 0, 0, 0)
    with open(path, "wb") as file:
        file.write(SIGNATURE)
        for kind, body in ((b"IHDR", header), (b"IDAT", zlib.compress(bytes(lines), 9)), (b"IEND", b"")):
            file.write(struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body)))


def read(path):
    """The pixels of a file that is neither interlaced nor indexed and has no alpha: (H, W, 1 or 3), uint8 or uint16."""
    data = Path(path).read_bytes()
    if not data.startswith(SIGNATURE):
        raise ValueError(f"{path}: not a PNG file")
    header, body, at = None, b"", len(SIGNATURE)
    while at < len(data):
        (length,) = struct.unpack_from(">I", data, at)
        kind, chunk = data[at + 4 : at + 8], data[at + 8 : at + 8 + length]
        if kind == b"IHDR":
            header = struct.unpack(">IIBBBBB", chunk)
        elif kind == b"IDAT":
            body += chunk
        at += length + 12
    width, height, depth, color_type, *rest = header
    channels = {value: key for key, value in COLOR_TYPE.items()}.get(color_type)
    if channels is None or depth not in (8, 16) or rest != [0, 0, 0]:
        raise ValueError(f"{path}: colour type {color_type} with {depth} bits is not supported")
    step = channels * depth // 8
    lines = np.frombuffer(zlib.decompress(body), np.uint8).reshape(height, width * step + 1)
    rows = np.zeros((height, width * step), np.uint8)
    above = np.zeros(width * step, np.uint8)
    for line, row in zip(lines, rows):
        undo_filter(line[0], line[1:], above, row, step)
        above = row
    return rows.reshape(-1).view(f">u{depth // 8}").astype(f"u{depth // 8}").reshape(height, width, channels)


def undo_filter(kind, residual, above, row, step):
    """Fill `row` from its residual and the row above."""
    if kind in (0, 2):
        row[:] = residual + above if kind == 2 else residual
        return
    if kind == 1:
        np.cumsum(residual.reshape(-1, step), axis=0, dtype=np.uint8, out=row.reshape(-1, step))
        return
    values = [0] * step + residual.tolist()
    up = [0] * step + above.tolist()
    for i in range(step, len(values)):
        if kind == 3:
            prediction = (values[i - step] + up[i]) // 2
        else:
            a, b, c = values[i - step], up[i], up[i - step]
            to_a, to_b, to_c = abs(b - c), abs(a - c), abs(a + b - 2 * c)
            prediction = a if to_a <= to_b and to_a <= to_c else b if to_b <= to_c else c
        values[i] = (values[i] + prediction) & 255
    row[:] = values[step:]


def paeth(left, above, corner):
    """The neighbour nearest to left + above - corner; ties go to left, then above (PNG specification, 9.4)."""
    to_left, to_above, to_corner = np.abs(above - corner), np.abs(left - corner), np.abs(left + above - 2 * corner)
    return np.where(
        (to_left <= to_above) & (to_left <= to_corner), left, np.where(to_above <= to_corner, above, corner)
    )
