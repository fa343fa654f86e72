"""Make novel views of a recording: simulated, from a rig, or lifted by SHARP frame by frame."""

import hashlib
import logging
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool
from tqdm import tqdm

from lagsplat.array_types import Frames, Series
from lagsplat.io.config import RecordingConfig
from lagsplat.io.files.atomic import sha256_of
from lagsplat.io.files.ply import PlyCloud, read_sharp
from lagsplat.io.read import read_recording
from lagsplat.io.recording.recording import Recording
from lagsplat.novel_views.sharp_tool import (
    LiftedFrame,
    SharpCache,
    cache_key,
    focal_px,
    require_sharp,
    run_sharp,
)
from lagsplat.splat.point_cloud import PointCloudScene, build_point_cloud, merge_clouds
from lagsplat.systems.config import ReleaseConfig
from lagsplat.systems.video import render_true_views
from lagsplat.views.camera import Camera, ViewSpace, arrange_cameras, center_camera
from lagsplat.views.config import ArrangementConfig, SharpConfig, ViewsConfig
from lagsplat.views.novel import KNOWN, NovelViews, cameras_bytes, collect_filmed_views
from lagsplat.views.rig import read_rig

LAYERS = 2  # of Gaussians in a lifted frame: the visible surface, and the one behind it
FINER = 2  # cells of a merged grid per pixel, each way
SAME_FOCAL = 1e-3
QUIET = 1.5  # times the median spread over time, plus one level, is the limit for still pixels
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class SharpLifting:
    """A clip to lift: its settings, its own camera, its still pixels and its cache."""

    sharp: SharpConfig
    arrangement: ArrangementConfig
    film: Camera
    still: Bool[np.ndarray, "H W"]
    cache: SharpCache


def make_sharp_views(
    recording: Recording, sharp: SharpConfig, arrangement: ArrangementConfig, folder: Path
) -> NovelViews:
    """Lift every frame and draw it, with one focal length, one pivot and one set of cameras for the clip.

    Frames in the cache are not lifted again, so a killed run resumes. The pivot is the median depth of the
    moving pixels of the first frame. The depths of each other frame, an independent estimate, are scaled to
    agree with the first on still pixels.

    Raises:
        ValueError: SHARP is not configured or missing, it used another focal length, or the cache has other
            cameras or settings.
        RuntimeError: SHARP fails.
    """
    frames = np.asarray(recording.frames)
    height, width = frames.shape[1:3]
    focal = focal_px(sharp.focal_35mm, height=height, width=width)
    film = center_camera(np.eye(3), np.zeros(3), focal=focal, height=height, width=width)
    lifting = SharpLifting(sharp, arrangement, film, find_still_pixels(frames), SharpCache(folder))
    keys = [cache_key(frame, sharp.focal_35mm, sharp.upscale) for frame in frames]
    with lifting.cache.held():
        space = _begin(lifting, frames[0], keys[0])
        _fill(lifting, space, dict(zip(keys, frames, strict=True)), reference=keys[0])
        found = [lifting.cache.find(key) for key in keys]
    lifted = [each for each in found if each is not None]
    assert len(lifted) == len(keys), "every frame has just been lifted"
    residual = float(np.median([each.told["residual"] for each in lifted]))
    log.info("depths agree to %.2g where nothing moves; cache: %.0f MB", residual, lifting.cache.size_mb())
    cameras, names, held_out = arrange_cameras(space, arrangement)
    return NovelViews(
        images=np.stack([each.images for each in lifted]),
        cover=np.stack([each.cover for each in lifted]),
        cameras=tuple(cameras),
        names=tuple(names),
        held_out=np.array(held_out),
        space=space,
    )


def find_still_pixels(frames: Frames) -> Bool[np.ndarray, "H W"]:
    """Pixels whose colours hardly vary over the clip."""
    spread = frames.astype(np.float32).std(0).mean(2)
    return spread <= QUIET * np.median(spread) + 1.0


def _begin(lifting: SharpLifting, frame: np.ndarray, key: str) -> ViewSpace:
    """The clip's coordinates: from the cache, or from the first frame, which is then lifted."""
    there = lifting.cache.manifest()
    started, cloud = time.monotonic(), None
    depth = None if there is None else there.get("pivot_depth")
    if depth is None:
        for _, ply in run_sharp({key: frame}, lifting.sharp, within=lifting.cache.folder):
            cloud = _cloud(ply, lifting)
            _keep_cloud(ply, lifting, key)
        assert cloud is not None, "the tool leaves no frame out without an error"
        shown = build_point_cloud(cloud, [lifting.film], blur_px2=lifting.sharp.blur_px2)
        moving = ~lifting.still & (shown.cover[0] > KNOWN)
        depth = float(np.median(shown.depth[0][moving if moving.any() else shown.cover[0] > KNOWN]))
        log.info("SHARP lifted the first frame; the pivot is %.3g m ahead", depth)
    space = ViewSpace(lifting.film, depth)
    cameras = arrange_cameras(space, lifting.arrangement)[0]
    lifting.cache.claim(
        {
            "cameras": hashlib.sha256(cameras_bytes(cameras)).hexdigest()[:16],
            "arrangement": asdict(lifting.arrangement),
            "pivot_depth": depth,
            "focal_35mm": lifting.sharp.focal_35mm,
            "upscale": lifting.sharp.upscale,
            "blur_px2": lifting.sharp.blur_px2,
            "first_frame": key,
        }
    )
    if cloud is not None:
        _agree_on_weights(lifting)
        lifting.cache.keep(key, _seen(cloud, lifting, cameras, None, started))
    return space


def _fill(lifting: SharpLifting, space: ViewSpace, frames: dict[str, np.ndarray], *, reference: str) -> None:
    """Lift the frames missing from the cache, the first frame first."""
    cameras = arrange_cameras(space, lifting.arrangement)[0]
    missing = {key: frame for key, frame in frames.items() if lifting.cache.find(key) is None}
    for chosen in ({reference} & set(missing), set(missing) - {reference}):
        todo = {key: missing[key] for key in chosen}
        if not todo:
            continue
        _agree_on_weights(lifting)
        first = lifting.cache.find(reference)
        started = time.monotonic()
        log.info(
            "SHARP: %d of %d frames to lift; each takes some 4 min of a processor core or 1 s of a GPU, and "
            "%.1f MB",
            len(todo),
            len(frames),
            4e-6 * len(cameras) * lifting.film.height * lifting.film.width,
        )
        with tqdm(total=len(frames), initial=len(frames) - len(todo), unit="frame", desc="SHARP") as bar:
            for key, ply in run_sharp(todo, lifting.sharp, within=lifting.cache.folder):
                depth = None if first is None else first.depth
                lifting.cache.keep(key, _seen(_cloud(ply, lifting), lifting, cameras, depth, started))
                _keep_cloud(ply, lifting, key)
                started = time.monotonic()
                bar.update()
                bar.set_postfix(MB=f"{lifting.cache.size_mb():.0f}")


def _agree_on_weights(lifting: SharpLifting) -> None:
    """Check that one network makes all frames of a cache."""
    require_sharp(lifting.sharp)
    checkpoint = Path(str(lifting.sharp.checkpoint)).expanduser()
    lifting.cache.name_weights(sha256_of(checkpoint))


def _cloud(ply: Path, lifting: SharpLifting) -> PlyCloud:
    """Read a lifted frame, merged down to the resolution of its images."""
    found, film, times = read_sharp(ply), lifting.film, lifting.sharp.upscale
    if abs(found.focal / times / film.focal[0] - 1) > SAME_FOCAL or found.width != times * film.width:
        raise ValueError(
            f"SHARP took the frame for {found.width} pixels wide, with a focal length of {found.focal:.1f}. "
            f"It was given {times * film.width} and {times * film.focal[0]:.1f}; views of one clip need one "
            "focal length: does this version read EXIF?"
        )
    side = round((len(found.cloud.means) / LAYERS) ** 0.5)
    by = max((n for n in range(1, side + 1) if side % n == 0 and side // n >= FINER * film.width), default=1)
    if LAYERS * side * side != len(found.cloud.means) or by == 1:
        return found.cloud
    return merge_clouds(found.cloud, side=side, by=by, layers=LAYERS)


def _keep_cloud(ply: Path, lifting: SharpLifting, key: str) -> None:
    if lifting.sharp.keep_clouds:
        ply.replace(lifting.cache.folder / f"{key}.ply")


def _seen(
    cloud: PlyCloud,
    lifting: SharpLifting,
    cameras: list[Camera],
    reference: np.ndarray | None,
    started: float,
) -> LiftedFrame:
    """Draw the frame's views, its depths scaled to the ``reference`` on still pixels."""
    blur = lifting.sharp.blur_px2
    own = build_point_cloud(cloud, [lifting.film], blur_px2=blur)
    scale, residual = (1.0, 0.0) if reference is None else align_depths(own, reference, lifting.still)
    moved = replace(cloud, means=scale * cloud.means, scales=scale * cloud.scales)
    shown = build_point_cloud(moved, cameras, blur_px2=blur)
    told = {"scale": scale, "residual": residual, "seconds": time.monotonic() - started}
    cover = np.round(255 * shown.cover.clip(0, 1)).astype(np.uint8)
    return LiftedFrame(shown.images, cover, np.float32(scale) * own.depth[0], told)


def align_depths(
    own: PointCloudScene, reference: np.ndarray, still: Bool[np.ndarray, "H W"]
) -> tuple[float, float]:
    """Scale a frame's depths to the reference on still pixels.

    Returns the factor and the median relative difference left; 1 and 0 if no pixel can be compared.
    """
    known = still & (own.cover[0] > KNOWN) & (reference > 0) & (own.depth[0] > 0)
    if not known.any():
        return 1.0, 0.0
    ratio = reference[known] / own.depth[0][known]
    scale = float(np.median(ratio))
    return scale, float(np.median(np.abs(scale / ratio - 1)))


Say = Callable[[str], None]


def obtain_views(
    config: ViewsConfig,
    recording: Recording,
    source: RecordingConfig,
    *,
    released: ReleaseConfig | None,
    states: Series | None,
    cache: Path,
) -> NovelViews:
    """Make the novel views that the settings ask for.

    Args:
        config: Kind and settings of the views.
        recording: The recording to view.
        source: Settings the recording was read with.
        released, states: The simulated system and its true states, if the recording is simulated.
        cache: Folder for lifted frames, unless the settings name another.

    Raises:
        ValueError: the kind of views does not suit the recording, or as the source of the views.
        FileNotFoundError: a file of the rig is missing.
    """
    if config.kind == "simulated":
        if released is None or states is None or config.arrangement is None:
            raise ValueError(
                "views=simulated: only a mechanism that is let go and simulated has a scene in space; choose "
                "recording=simulated and such a system, or views=rig or views=none"
            )
        return render_true_views(released, states, config.arrangement)
    if config.sharp is not None and config.kind == "sharp":
        assert config.arrangement is not None, "checked with the settings"
        folder = cache if config.sharp.cache is None else Path(config.sharp.cache).expanduser()
        return make_sharp_views(recording, config.sharp, config.arrangement, folder)
    assert config.rig is not None, "checked with the settings"
    if source.kind != "video" or source.path is None:
        raise ValueError(
            f"views=rig: the recording is the reference camera's film, not of kind {source.kind}; give "
            "recording=filmed recording.path=FILM"
        )
    if source.crop or source.rotate or source.stabilise:
        raise ValueError(
            "views=rig: recording.crop, rotate and stabilise move pixels away from where the calibration has "
            "them; use whole pictures"
        )
    film = Path(source.path).expanduser()

    def read(path: Path) -> Recording:
        return read_recording(replace(source, path=str(path), height=recording.height, width=recording.width))

    return collect_filmed_views(read_rig(Path(config.rig)), recording, film, read)
