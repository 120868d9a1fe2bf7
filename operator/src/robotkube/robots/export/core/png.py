"""Small pictures without a library: a raster of grey and coloured pixels, written as PNG. Pure."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable

Colour = tuple[int, int, int]
BLACK = (16, 18, 24)
GREY = (52, 56, 66)
WHITE = (225, 225, 225)
GREEN = (70, 220, 120)
ORANGE = (255, 160, 40)
SIGNATURE = b"\x89PNG\r\n\x1a\n"
STEPS_MAX = 10_000


class Picture:
    """A raster of `width` x `height` pixels; what lies outside is left out."""

    def __init__(self, width: int, height: int, ground: Colour = BLACK) -> None:
        self.width = width
        self.height = height
        self._rows = [bytearray(ground * width) for _ in range(height)]

    def point(self, x: float, y: float, colour: Colour) -> None:
        """Set one pixel, counted from the upper left corner."""
        column, row = int(x), int(y)
        if 0 <= column < self.width and 0 <= row < self.height:
            self._rows[row][3 * column : 3 * column + 3] = bytes(colour)

    def line(self, x0: float, y0: float, x1: float, y1: float, colour: Colour) -> None:
        """Draw a straight line."""
        steps = min(STEPS_MAX, max(1, int(max(abs(x1 - x0), abs(y1 - y0)))))
        for step in range(steps + 1):
            share = step / steps
            self.point(x0 + (x1 - x0) * share, y0 + (y1 - y0) * share, colour)

    def outline(self, corners: Iterable[tuple[float, float]], colour: Colour) -> None:
        """Draw lines between corners, from the last to the first, too."""
        points = list(corners)
        for (x0, y0), (x1, y1) in zip(points, points[1:] + points[:1], strict=True):
            self.line(x0, y0, x1, y1, colour)

    def colour(self, x: int, y: int) -> Colour:
        """The colour of one pixel."""
        red, green, blue = self._rows[y][3 * x : 3 * x + 3]
        return red, green, blue

    def png(self) -> bytes:
        """The picture as a file (PNG specification, colour type 2, no filter)."""
        head = struct.pack(">IIBBBBB", self.width, self.height, 8, 2, 0, 0, 0)
        body = zlib.compress(b"".join(b"\0" + row for row in self._rows), 9)
        return SIGNATURE + b"".join(
            _chunk(kind, data) for kind, data in ((b"IHDR", head), (b"IDAT", body), (b"IEND", b""))
        )


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
