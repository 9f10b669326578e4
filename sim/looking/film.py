"""Films: frames into MP4, WebP or GIF.

WebP and GIF are written by Pillow. MP4 is written by ffmpeg, which the package imageio-ffmpeg
brings as one static program, without a library that could meet another of the same name; it encodes
on another core while frames are drawn.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path

from PIL import Image

from planner.errors import TaskError
from sim.looking.painter import Pixels, Quality

__all__ = ["FORMATS", "FilmFormat", "check_video", "write_film"]


@dataclass(frozen=True, kw_only=True)
class FilmFormat:
    """What a kind of file is given.

    Attributes:
        quality: How its frames are drawn.
        rate: Frames per second.
        most: Frames that a film may have; longer ones are shown faster. Pillow keeps them all.
        encoding: Options of ffmpeg, for MP4.
    """

    quality: Quality
    rate: float
    most: int
    encoding: tuple[str, ...] = ()


LARGE = Quality(size=(640, 480), larger=1.5, shadows=2048, slices=20)
SMALL = replace(LARGE, size=(480, 360), larger=2.0)

X264 = ("-crf", "23", "-preset", "veryfast", "-movflags", "+faststart", "-tune", "animation")
"""Options of ffmpeg: constant quality, and a file that plays while it loads."""

FORMATS = {
    ".mp4": FilmFormat(quality=LARGE, rate=25.0, most=1500, encoding=X264),
    ".webp": FilmFormat(quality=LARGE, rate=20.0, most=600),
    ".gif": FilmFormat(quality=SMALL, rate=12.5, most=500),
}
"""File ending -> format. A GIF has 256 colours and is several times as large: so it is smaller."""

WEBP_QUALITY, WEBP_EFFORT = 62, 2
"""As ``cwebp -q`` and ``-m``: beyond effort 2 files become 5 % smaller and take twice as long."""

COLORS = 160
"""Colours of a GIF."""


def check_video(path: Path | str | None) -> None:
    """Refuse a film that cannot be written, before the work and not after it.

    Raises:
        TaskError: Another file ending, or MP4 without the package that writes it.
    """
    if path is None:
        return
    ending = Path(path).suffix.lower()
    if ending not in FORMATS:
        raise TaskError(f"a video {Path(path).name!r} is not known; give {', '.join(FORMATS)}")
    if ending == ".mp4" and find_spec("imageio_ffmpeg") is None:
        raise TaskError(
            f"{Path(path).name} needs a package that is not installed: pip install "
            '"opposable[video]"; .webp and .gif need nothing more'
        )


def write_film(path: Path, frames: Iterable[Pixels], film: FilmFormat) -> None:
    """Encode frames.

    Args:
        path: Its ending is one of ``FORMATS``.
        frames: At least one, drawn as they are asked for.
        film: Size and rate.

    Raises:
        OSError: The file cannot be written.
    """
    if path.suffix.lower() == ".mp4":
        _write_mp4(path, frames, film)
        return
    images = [Image.fromarray(pixels) for pixels in frames]
    duration = round(1e3 / film.rate)
    if path.suffix.lower() == ".webp":
        images[0].save(
            path,
            save_all=True,
            append_images=images[1:],
            duration=duration,
            loop=0,
            quality=WEBP_QUALITY,
            method=WEBP_EFFORT,
        )
        return
    no = Image.Dither.NONE
    palette = images[len(images) // 2].quantize(COLORS, dither=no)
    few = [image.quantize(palette=palette, dither=no) for image in images]
    few[0].save(path, save_all=True, append_images=few[1:], duration=duration, loop=0)


def _write_mp4(path: Path, frames: Iterable[Pixels], film: FilmFormat) -> None:
    import imageio_ffmpeg

    path.touch()  # ffmpeg's own words about a folder that bars it are many lines
    writer = imageio_ffmpeg.write_frames(
        str(path),
        film.quality.size,
        fps=film.rate,
        codec="libx264",
        quality=None,
        output_params=list(film.encoding),
        ffmpeg_log_level="error",
    )
    writer.send(None)
    try:
        for pixels in frames:
            writer.send(pixels)
    finally:
        writer.close()
