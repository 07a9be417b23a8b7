"""Pictures of 8 bits as PNG in memory, for pages and for files that are written whole or not at all."""

import struct
import zlib

import numpy as np
from jaxtyping import UInt8

COLOUR_TYPES = {1: 0, 3: 2, 4: 6}  # by channels: grey, RGB, RGBA


def encoded(pixels: UInt8[np.ndarray, "height width channels"]) -> bytes:
    """PNG of one, three or four channels.

    By hand: the libraries at hand write to files only, and a full disk is no reason to lose a report.

    >>> encoded(np.zeros((1, 1, 3), np.uint8))[1:4]
    b'PNG'
    """
    height, width, channels = pixels.shape
    rows = np.ones((height, 1 + width * channels), np.uint8)  # each begins with its filter, 1: difference to the left
    rows[:, 1:] = np.diff(pixels, axis=1, prepend=np.uint8(0)).reshape(height, -1)
    header = struct.pack(">IIBBBBB", width, height, 8, COLOUR_TYPES[channels], 0, 0, 0)
    # Half the time of zlib's own level and strategy, for as many bytes of such pictures.
    deflate = zlib.compressobj(4, strategy=zlib.Z_FILTERED)
    chunks = {b"IHDR": header, b"IDAT": deflate.compress(rows.tobytes()) + deflate.flush(), b"IEND": b""}
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in chunks.items()
    )
