"""How large a picture may be, checked before room is made for its pixels."""

from pathlib import Path

from fit.input_error import InputError

LARGEST_PIXELS = 64_000_000
LARGEST_RATIO = 150  # of pixels in memory to the file: photos reach 60 by lossy compression, one colour 200 to 1000
UNQUESTIONED_BYTES = 2**26  # of pixels, which any file may unpack to


def check_size(path: Path, width: int, height: int) -> None:
    """Refuse a picture that is larger than any camera's, before its pixels are read.

    Raises:
        InputError: above 64 megapixels.
    """
    if width * height > LARGEST_PIXELS:
        raise InputError(f"{path} is {width} x {height}; at most {LARGEST_PIXELS:,} pixels are read: scale it down")


def check_packing(path: Path, pixel_bytes: int) -> None:
    """Refuse a small file that unpacks to a large picture: no photo does, and it would take all memory and much time.

    Raises:
        InputError: above 64 MiB of pixels when they are more than 150 times as large as their file.
    """
    packed = path.stat().st_size
    if pixel_bytes > max(UNQUESTIONED_BYTES, LARGEST_RATIO * packed):
        raise InputError(
            f"{path} would unpack from {packed / 1e6:.3g} to {pixel_bytes / 1e6:.3g} MB; "
            f"photos do to at most {LARGEST_RATIO} times their file: copy or export it again, or scale it down"
        )
