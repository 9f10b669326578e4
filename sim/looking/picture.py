"""Pictures and films of what a tape holds, all drawn by one OpenGL context.

A picture is made where it can be. Where no way to draw works there is none but a reason, in one
line, and never an error.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from PIL import Image

from sim.looking.film import FORMATS, FilmFormat, check_video, write_film
from sim.looking.painter import Painter, Pixels, Quality, open_painter
from sim.looking.tape import Frame, Tape
from sim.looking.view import View, choose_views

__all__ = ["PICTURE", "Drawn", "draw_tape", "moments_of"]

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
    """Draw pictures at moments, and a film.

    Args:
        tape: What was recorded.
        pictures: File (its ending says the format, as for Pillow) -> moment, s; None for the end.
        video: File of a film, one of ``film.FORMATS``.
        arrows: Draw the contact forces, and the object as glass.

    Raises:
        TaskError: A film of an unknown kind, or MP4 without the package that writes it.
    """
    check_video(video)
    if not tape.frames:
        return Drawn(reason="there is nothing to draw: no state was kept")
    stills = _draw_stills(tape, dict(pictures or {}), arrows)
    if video is None or stills.reason:
        return stills
    film = _draw_film(tape, video, FORMATS[video.suffix.lower()], arrows)
    return replace(film, files=(*stills.files, *film.files), moments=stills.moments)


def moments_of(picture: Path | str | None, failed_at: float | None) -> dict[Path, float | None]:
    """The pictures of a trial: its end; of one that failed, where it went wrong, and its end.

    Args:
        picture: The first of them; none if None.
        failed_at: When it failed, s; None if it did not.
    """
    if picture is None:
        return {}
    path = Path(picture)
    if failed_at is None:
        return {path: None}
    return {path: failed_at, path.with_name(f"{path.stem}-end{path.suffix}"): None}


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
