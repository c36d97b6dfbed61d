"""Frames of folders ask their pictures for the convention of their poses before they are taken."""

import re
from contextlib import suppress
from dataclasses import replace

import numpy as np

from omniscv.errors import ArgumentError, OmniscvError
from omniscv.geometry import Array, Pose, pinhole
from omniscv.geometry.trajectory_columns import axes_of, frame_of_axes
from omniscv.importing.conventions import PAIRS, WIDTH, Verdict, Words, ask
from omniscv.importing.lenses import straight
from omniscv.importing.overlap import PosedPictures, Shot
from omniscv.importing.posed_frames import Frame, Sequence

_LARGE = 1 << 21  # pixels


def taken(sequence: Sequence, trust_words: bool) -> tuple[Sequence, tuple[str, ...]]:
    """Return a sequence as its pictures say it is read, and a line.

    Args:
        sequence: as it was read.
        trust_words: take it as said, whatever pictures show.

    Raises:
        ArgumentError: pictures contradict what is said.
    """
    verdict = verdict_on(sequence)
    if sequence.refused and not (verdict and verdict.contradicts):
        raise ArgumentError(sequence.refused)
    if verdict is None:
        return sequence, ()
    if verdict.misfit is not None and not trust_words:
        expected = f"expected depth that belongs to its colours and poses, got {verdict.misfit.shows}"
        raise ArgumentError(f"{expected}; {verdict.misfit.remedy}; or --trust-words takes it as said")
    if not verdict.contradicts:
        if verdict.colors and not trust_words:
            expected = "expected colours that lie over depth, got colours that agree if they are turned"
            remedy = f"write colours {verdict.colors} (depth is as it should be)"
            raise ArgumentError(f"{expected}; {remedy}; or --trust-words takes them as said")
        return sequence, (verdict.line(),)
    if trust_words and not sequence.refused:
        return sequence, (f"{verdict.line()}; taken as said",)
    right = put_right(sequence, verdict) if verdict.words.asks else None
    if right is not None:
        return right, (f"{verdict.line()}; taken as pictures show",)
    expected = f"expected pictures that overlap as said, {verdict.described(verdict.words.convention)}"
    words = f"write {verdict.advice(sequence.layout)}; or --trust-words takes them as said"
    raise ArgumentError(f"{expected}; got {verdict.line()}; {words}")


def verdict_on(sequence: Sequence) -> Verdict | None:
    """Return what the pictures of a sequence say; None of frames without depth, or of one frame."""
    words = words_of(sequence)
    if words is None or len(ordered(sequence)) < 2:
        return None
    pictures = read_pictures(sequence, PAIRS, WIDTH)
    if pictures is None:
        return Verdict(words, why="no two frames with depth can be compared")
    return ask(pictures, words)


def words_of(sequence: Sequence) -> Words | None:
    """Return what is said of the poses and the depth of a sequence; None where there is no depth."""
    frames = ordered(sequence)
    if not frames:
        return None
    form = sequence.form(frames[0])
    return replace(sequence.words, along=form.ray, per_m=form.per_m or 1.0)


def ordered(sequence: Sequence) -> list[Frame]:
    """Return the frames with depth, in the order of the numbers in their names."""

    def key(frame: Frame) -> list[str]:
        return [word.zfill(20) for word in re.split(r"(\d+)", str(frame.files["depth"]))]

    frames = [frame for frame in sequence.frames if "depth" in frame.files]
    return sorted(frames, key=key)


def read_pictures(sequence: Sequence, pairs: int, width: int) -> PosedPictures | None:
    """Return pictures of pairs of frames, without those that cannot be read: the import says so.

    Args:
        sequence: of the frames.
        pairs: so many at most.
        width: of the pictures, px, at most.
    """
    frames = ordered(sequence)
    pixel_counts: list[int] = []

    def shot(i: int, most: int) -> Shot | None:
        """Return the picture of the frame ``i``, of at most ``most`` px width; None if it cannot be read."""
        frame = frames[i]
        with suppress(OmniscvError):
            depth = sequence.picture(frame, "depth").pixels
            pixel_counts.append(depth.size)
            lit = sequence.picture(frame, "lit").pixels if "lit" in frame.files else None
            lens = frame.lens.scaled(*depth.shape[1::-1]) if frame.lens else None
            if lens is not None and lens.is_bent:
                if lit is not None:
                    lit, _ = straight(lit, lens.scaled(*lit.shape[1::-1]), "lit")
                depth, lens = straight(depth, lens, "depth")
                depth = depth[..., 0]
            return Shot.of(depth, lit, lens, most)
        return None

    first = None
    for i in range(len(frames)):
        first = shot(i, width)
        if first:
            break
    if first is None:
        return None
    fov_deg = 360.0 if first.lens is None else pinhole.fov_deg(first.depth.shape[1], first.lens[0])
    if max(pixel_counts) > _LARGE:
        pairs = pairs // 3  # they take longer to read
    return PosedPictures.read(*poses_of(frames), shot, np.radians(fov_deg), pairs, width)


def poses_of(frames: list[Frame]) -> tuple[Array, Array]:
    """Return the rotations and positions of frames."""
    R = np.stack([frame.pose.R_w_c for frame in frames])
    t = np.stack([frame.pose.position for frame in frames])
    return R, t


def put_right(sequence: Sequence, verdict: Verdict) -> Sequence | None:
    """Return a ``sequence`` by the convention of a ``verdict``; None where poses belong to other frames."""
    assert verdict.best is not None
    convention = verdict.best.convention
    metres, per_m = verdict.units(convention)
    forms = [frame.holds["depth"].form for frame in sequence.frames if "depth" in frame.holds]
    packed = any(form.encoding for form in forms)
    if convention.shift or convention.quaternion or packed or sequence.options.depth:
        return None
    file = verdict.words.written(*poses_of(sequence.frames))
    W, _ = axes_of(frame_of_axes(convention.C))
    R, t = convention._replace(ratio=verdict.words.metres / metres).poses(*file)
    kind = "ray" if convention.along else "planar"
    unit = f"1/{per_m!r}" if per_m != 1 else ""
    frames = []
    for frame, rotation, position in zip(sequence.frames, W @ R, t @ W.T, strict=True):
        holds = {**frame.holds}
        if "depth" in holds:
            holds["depth"] = replace(holds["depth"], kind=kind, unit=unit)
        frames.append(replace(frame, pose=Pose(position, rotation), holds=holds))
    return replace(sequence, frames=frames)
