"""Unpacking of compressed bytes and files within bounds: the sizes that they name are not to be trusted."""

from __future__ import annotations

from pathlib import Path

ZSTD = "zstd"
LZ4 = "lz4"
FILE_BYTES_MAX = 64 * 1024**3
WINDOW_BYTES_MAX = 128 * 1024**2
_BLOCK = 1024 * 1024
_PACKED_BLOCK = 8192  # one of these holds at most 256 MB
_ZSTD_BEGIN = b"\x28\xb5\x2f\xfd"  # no serialised message begins so


def unpack(kind: str, data: bytes, size: int) -> bytes:
    """Unpack at most `size` bytes; fewer when the data are cut off. ValueError: they are damaged or of another kind."""
    if not kind:
        return data[:size]
    if kind == ZSTD:
        return _zstd(data, size)
    if kind == LZ4:
        return _lz4(data, size)
    raise ValueError(f"compression {kind[:20]!r} is none of {ZSTD}, {LZ4}")


def unpack_message(kind: str, data: bytes, size_max: int) -> bytes:
    """Unpack one message that was compressed alone; ValueError when it is damaged or larger than `size_max`."""
    if kind != ZSTD:
        raise ValueError(f"message compression {kind[:20]!r} is not {ZSTD}")
    import zstandard

    try:
        size = zstandard.frame_content_size(data)
    except zstandard.ZstdError as error:
        raise ValueError(str(error)) from error
    if size > size_max:
        raise ValueError(f"a message of {size} bytes; {size_max} are read")
    message = _zstd(data, size if size >= 0 else size_max)
    if size >= 0 and len(message) < size:
        raise ValueError("a compressed message is cut off")
    return message


def is_packed(data: bytes) -> bool:
    """Return whether a message was compressed alone."""
    return data.startswith(_ZSTD_BEGIN)


def unpack_file(source: Path, target: Path) -> str:
    """Unpack a file in zstd; what is wrong with it, or `""`. What came before the fault is in `target`. OSError."""
    import zstandard

    decompressor = zstandard.ZstdDecompressor(max_window_size=WINDOW_BYTES_MAX)
    unpacker = decompressor.decompressobj()
    written = 0
    whole = False
    with source.open("rb") as file, target.open("wb") as output:
        while block := file.read(_PACKED_BLOCK):
            while block:
                try:
                    written += output.write(unpacker.decompress(block))
                except zstandard.ZstdError as error:
                    return f"is damaged behind its byte {written} ({error})"
                if written > FILE_BYTES_MAX:
                    return f"holds more than {FILE_BYTES_MAX} bytes"
                whole = unpacker.eof
                block = unpacker.unused_data
                if whole:  # a file may be several parts, one behind the other
                    unpacker = decompressor.decompressobj()
    return "" if whole else f"is cut off; {written} bytes could be unpacked"


def _zstd(data: bytes, size: int) -> bytes:
    import zstandard

    unpacked = bytearray()
    left = size
    try:
        with zstandard.ZstdDecompressor(max_window_size=WINDOW_BYTES_MAX).stream_reader(data) as stream:
            while left > 0 and (block := stream.read(min(left, _BLOCK))):
                unpacked += block
                left -= len(block)
    except zstandard.ZstdError as error:
        if not unpacked:
            raise ValueError(str(error)) from error
    return bytes(unpacked)


def _lz4(data: bytes, size: int) -> bytes:
    import lz4.frame

    try:
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=max(size, 1))[:size])
    except (RuntimeError, EOFError) as error:
        raise ValueError(str(error)) from error
