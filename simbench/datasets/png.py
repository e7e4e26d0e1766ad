"""A PNG reduced to the chunks that make its pixels, each whole and in its place.

A decoder takes memory by what a chunk claims: 2 GB for a length of 2^31 − 1, or for a second header
or an animation of another size. So the chunks are walked before it sees any of them.
"""

from __future__ import annotations

SIGNATURE = b"\x89PNG\r\n\x1a\n"
_OF_PIXELS = (b"IHDR", b"PLTE", b"tRNS", b"IDAT", b"IEND")
_AROUND = 12        # bytes of a chunk's length, kind and checksum
_HEADER = 13


def pixels_only(data: bytes) -> bytes:
    """The image of a PNG without texts, colour profiles, times and animations.

    Raises:
        ValueError: a chunk reaches beyond the file's end, the header is not the first chunk or
            stands there twice, or the image does not end.
    """
    if not data.startswith(SIGNATURE):
        raise ValueError("no PNG")
    kept, at, kind = [SIGNATURE], len(SIGNATURE), b""
    while kind != b"IEND":
        end = at + _AROUND + int.from_bytes(data[at:at + 4], "big")
        if end > len(data) or at + _AROUND > len(data):
            raise ValueError("truncated")
        kind = data[at + 4:at + 8]
        first = at == len(SIGNATURE)
        if (kind == b"IHDR") != first or (first and end - at != _AROUND + _HEADER):
            raise ValueError("spoilt, its header not where it belongs")
        if kind in _OF_PIXELS:
            kept.append(data[at:end])
        at = end
    return b"".join(kept)
