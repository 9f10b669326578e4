"""Pictures and films of what a ``Tape`` holds, drawn after the simulation by one OpenGL context.

A tape only reads, so that a simulation goes on as it would without it. A picture is made where it
can be; where no way to draw works there is none but a reason, in one line, and never an error.

WebP and GIF are written by Pillow. MP4 is written by ffmpeg, which the package imageio-ffmpeg
brings as one static program, without a library that could meet another of the same name; it encodes
on another core while frames are drawn.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from planner.contacts import ContactSet
from planner.errors import TaskError
from planner.spatial import FloatArray
from sim.show.camera import Subject, View, choose_views
from sim.show.painter import Arrows, Painter, Pixels, Quality, open_painter

FRAME_RATE = 25.0
"""States kept per simulated second."""


@dataclass(frozen=True, kw_only=True)
class Frame:
    """One state.

    Attributes:
        time: s.
        qpos: State (nq,) of the model.
        arrows: Forces of the hand on the object; None if they are not known.
    """

    time: float
    qpos: FloatArray
    arrows: Arrows | None = None


class Tape:
    """States of one model in the order of time.

    Attributes:
        model: ``mujoco.MjModel``.
        subject: What its pictures are about.
        frames: What was kept.
    """

    def __init__(self, model: Any, subject: Subject) -> None:
        """An empty tape."""
        self.model, self.subject = model, subject
        self.frames: list[Frame] = []

    def keep(self, time: float, qpos: FloatArray, contacts: ContactSet | None = None) -> None:
        """Keep a state.

        Args:
            time: s; not before the last one's.
            qpos: State (nq,).
            contacts: Contacts with the object, whose forces arrows may show.
        """
        arrows = None
        if contacts is not None:
            arrows = Arrows(
                points=contacts.positions,
                forces=np.nan_to_num(contacts.forces_in_axes()),
                object_body=self.subject.object_body,
            )
        self.frames.append(Frame(time=time, qpos=np.array(qpos), arrows=arrows))

    def at(self, time: float | None) -> Frame:
        """The state kept next to a time (s); the last one if None."""
        if time is None:
            return self.frames[-1]
        return min(self.frames, key=lambda frame: abs(frame.time - time))

    def evenly(self, rate: float, most: int) -> tuple[list[Frame], float]:
        """States at an even rate, and by how much a film of them is faster than the simulation.

        Args:
            rate: Frames per second of the film.
            most: Frames that it may have; a longer simulation is shown faster.
        """
        times = np.array([frame.time for frame in self.frames])
        length = times[-1] - times[0]
        speed = max(1.0, length * rate / most)
        wanted = times[0] + np.arange(0.0, length + 1e-9, speed / rate)
        after = np.minimum(np.searchsorted(times, wanted), len(times) - 1)
        before = np.maximum(after - 1, 0)
        nearer = np.where(wanted - times[before] < times[after] - wanted, before, after)
        return [self.frames[i] for i in nearer], speed


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


PICTURE = Quality(size=(960, 720), larger=2.0, shadows=4096, slices=40)
"""How a picture is drawn."""


MOST_NAMES = 4
"""Names of pictures that are told; of more, how many there are."""


@dataclass(frozen=True, kw_only=True)
class Drawn:
    """What was drawn, or why it was not.

    Attributes:
        files: What was written, in order.
        moments: Pictures of a moment, s, that was asked for.
        backend: How it was drawn, such as "EGL"; "" if nothing could be.
        reason: Why something is missing, "" if nothing is.
        speed: How much faster than the simulation the film is.
    """

    files: tuple[Path, ...] = ()
    moments: Mapping[Path, float | None] = field(default_factory=dict)
    backend: str = ""
    reason: str = ""
    speed: float = 1.0

    def __str__(self) -> str:
        """One line."""
        names = ", ".join(self._names())
        fast = f", {self.speed:.1f} times as fast as simulated" if self.speed > 1.01 else ""
        done = f"{names} (drawn by {self.backend}{fast})" if names else ""
        return "; ".join(part for part in (done, self.reason) if part)

    def _names(self) -> list[str]:
        films = [file for file in self.files if file.suffix.lower() in FORMATS]
        stills = [file for file in self.files if file not in films]
        if len(stills) > MOST_NAMES:
            return [f"{len(stills)} pictures", *(film.name for film in films)]
        times = [self.moments.get(file) for file in stills]
        return [
            still.name if time is None else f"{still.name} at {time:.2f} s"
            for still, time in zip(stills, times, strict=True)
        ] + [film.name for film in films]


def draw_tape(
    tape: Tape,
    *,
    pictures: Mapping[Path, float | None] | None = None,
    video: Path | None = None,
    arrows: bool = False,
) -> Drawn:
    """Draw pictures at moments, and a film. Ctrl-C ends it, and keeps the pictures drawn by then.

    Args:
        tape: What was recorded.
        pictures: File (its ending says the format, as for Pillow) -> moment, s; None for the end.
        video: File of a film, its ending is one of ``FORMATS``.
        arrows: Draw the contact forces, and the object as glass.

    Raises:
        TaskError: A film of an unknown kind, or MP4 without the package that writes it.
    """
    check_video(video)
    if not tape.frames:
        return Drawn(reason="there is nothing to draw: no state was kept")
    stills = Drawn()
    try:
        stills = _draw_stills(tape, dict(pictures or {}), arrows)
        if video is None or stills.reason:
            return stills
        film = _draw_film(tape, video, FORMATS[video.suffix.lower()], arrows)
    except KeyboardInterrupt:  # of the drawing alone: what was simulated is to be reported
        return replace(stills, reason="the drawing was ended by Ctrl-C")
    return replace(film, files=(*stills.files, *film.files), moments=stills.moments)


def moments_of(picture: Path | str | None, moment: float | None) -> dict[Path, float | None]:
    """The pictures of a trial: its end; before it, a moment of which there is more to be seen.

    Args:
        picture: The first of them; none if None.
        moment: When that was, s, as where it went wrong; None if there is no such moment.
    """
    if picture is None:
        return {}
    path = Path(picture)
    if moment is None:
        return {path: None}
    return {path: moment, path.with_name(f"{path.stem}-end{path.suffix}"): None}


def _draw_stills(tape: Tape, wanted: Mapping[Path, float | None], arrows: bool) -> Drawn:
    """One picture per file, each framed by itself."""
    if not wanted:
        return Drawn()
    painter = open_painter(tape.model, PICTURE)
    if isinstance(painter, str):
        return Drawn(reason=painter)
    frames = [tape.at(moment) for moment in wanted.values()]
    views = choose_views(
        tape.model, [f.qpos for f in frames], tape.subject, _aspect(PICTURE.size), follow=None
    )
    files: list[Path] = []
    with painter:
        for path, pixels in zip(wanted, _drawn(painter, frames, views, arrows), strict=True):
            try:
                Image.fromarray(pixels).save(path)
            except (OSError, ValueError) as error:  # ValueError: an ending that Pillow cannot write
                reason = _cannot_write(path, error)
                return Drawn(
                    files=tuple(files), moments=wanted, backend=painter.backend, reason=reason
                )
            files.append(path)
    return Drawn(files=tuple(files), moments=wanted, backend=painter.backend)


def _draw_film(tape: Tape, path: Path, film: FilmFormat, arrows: bool) -> Drawn:
    painter = open_painter(tape.model, film.quality)
    if isinstance(painter, str):
        return Drawn(reason=painter)
    frames, speed = tape.evenly(film.rate, film.most)
    views = choose_views(
        tape.model,
        [f.qpos for f in frames],
        tape.subject,
        _aspect(film.quality.size),
        follow=film.rate / speed,
    )
    with painter:
        try:
            write_film(path, _drawn(painter, frames, views, arrows), film)
        except OSError as error:
            return Drawn(backend=painter.backend, reason=_cannot_write(path, error))
    return Drawn(files=(path,), backend=painter.backend, speed=speed)


def _drawn(
    painter: Painter, frames: Sequence[Frame], views: Sequence[View], arrows: bool
) -> Iterator[Pixels]:
    painter.light(views[0])
    for frame, view in zip(frames, views, strict=True):
        yield painter.draw(frame.qpos, view, frame.arrows if arrows else None)


def _aspect(size: tuple[int, int]) -> float:
    return size[0] / size[1]


def _cannot_write(path: Path, error: Exception) -> str:
    return f"cannot write {path}: {getattr(error, 'strerror', None) or error}"
