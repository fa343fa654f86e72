"""Make novel views of a recording: simulated, from a rig, or lifted by SHARP frame by frame."""

import hashlib
import logging
import time
from collections.abc import Iterator
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
from lagsplat.novel_views import sharp_tool
from lagsplat.novel_views.sharp_tool import LiftedFrame, SharpCache
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
    focal = sharp_tool.focal_px(sharp.focal_35mm, height=height, width=width)
    camera = center_camera(np.eye(3), np.zeros(3), focal=focal, height=height, width=width)
    lifting = SharpLifting(sharp, arrangement, camera, find_still_pixels(frames), SharpCache(folder))
    keys = [sharp_tool.cache_key(frame, sharp.focal_35mm, sharp.upscale) for frame in frames]
    with lifting.cache.lock():
        space = lifting.begin(frames[0], keys[0])
        first = lifting.cache.find(keys[0])
        assert first is not None, "it has just been lifted"
        lifting.fill(space, dict(zip(keys, frames, strict=True)), first.depth)
        lifted = [each for each in map(lifting.cache.find, keys) if each is not None]
    residual = float(np.median([each.alignment["residual"] for each in lifted]))
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


@dataclass(frozen=True)
class SharpLifting:
    """A clip to lift: its settings, its own camera, its still pixels and its cache."""

    sharp: SharpConfig
    arrangement: ArrangementConfig
    camera: Camera
    still: Bool[np.ndarray, "H W"]
    cache: SharpCache

    def begin(self, frame: np.ndarray, key: str) -> ViewSpace:
        """The clip's coordinates, from the cache or the first frame, which is lifted if it is not cached."""
        started, cloud = time.monotonic(), None
        depth = (self.cache.manifest() or {}).get("pivot_depth")
        if depth is None:
            cloud = dict(self._lift({key: frame}))[key]
            shown = build_point_cloud(cloud, [self.camera], blur_px2=self.sharp.blur_px2)
            covered = shown.cover[0] > KNOWN
            moving = ~self.still & covered
            depth = float(np.median(shown.depth[0][moving if moving.any() else covered]))
            log.info("SHARP lifted the first frame; the pivot is %.3g m ahead", depth)
        space = ViewSpace(self.camera, depth)
        cameras = arrange_cameras(space, self.arrangement)[0]
        self.cache.claim(
            {
                "cameras": hashlib.sha256(cameras_bytes(cameras)).hexdigest()[:16],
                "arrangement": asdict(self.arrangement),
                "pivot_depth": depth,
                "focal_35mm": self.sharp.focal_35mm,
                "upscale": self.sharp.upscale,
                "blur_px2": self.sharp.blur_px2,
                "first_frame": key,
            }
        )
        if cloud is not None or self.cache.find(key) is None:
            self._check_weights()
            cloud = cloud or dict(self._lift({key: frame}))[key]
            self.cache.keep(key, self._draw(cloud, cameras, None, started))
        return space

    def fill(self, space: ViewSpace, frames: dict[str, np.ndarray], reference: np.ndarray) -> None:
        """Lift the frames missing from the cache; ``reference`` are the depths of the first."""
        cameras = arrange_cameras(space, self.arrangement)[0]
        missing = {key: frame for key, frame in frames.items() if self.cache.find(key) is None}
        if not missing:
            return
        self._check_weights()
        log.info(
            "SHARP: %d of %d frames to lift; each takes some 4 min of a processor core or 1 s of a GPU, and "
            "%.1f MB",
            len(missing),
            len(frames),
            4e-6 * len(cameras) * self.camera.height * self.camera.width,
        )
        started, done = time.monotonic(), len(frames) - len(missing)
        with tqdm(total=len(frames), initial=done, unit="frame", desc="SHARP") as bar:
            for key, cloud in self._lift(missing):
                self.cache.keep(key, self._draw(cloud, cameras, reference, started))
                started = time.monotonic()
                bar.update()
                bar.set_postfix(MB=f"{self.cache.size_mb():.0f}")

    def _lift(self, frames: dict[str, np.ndarray]) -> Iterator[tuple[str, PlyCloud]]:
        """The frames' clouds, as soon as each is ready."""
        for key, ply in sharp_tool.run_sharp(frames, self.sharp, within=self.cache.folder):
            yield key, self._read_cloud(ply)
            if self.sharp.keep_clouds:
                ply.replace(self.cache.folder / f"{key}.ply")

    def _check_weights(self) -> None:
        """Check that one network makes all frames of a cache."""
        sharp_tool.require_sharp(self.sharp)
        self.cache.name_weights(sha256_of(Path(str(self.sharp.checkpoint)).expanduser()))

    def _read_cloud(self, ply: Path) -> PlyCloud:
        """A lifted frame, merged down to the resolution of its images."""
        scene, times, width = read_sharp(ply), self.sharp.upscale, self.camera.width
        if abs(scene.focal / times / self.camera.focal[0] - 1) > SAME_FOCAL or scene.width != times * width:
            raise ValueError(
                f"SHARP took the frame for {scene.width} px wide, its focal length for {scene.focal:.1f} px, "
                f"but was given {times * width} and {times * self.camera.focal[0]:.1f}; views of one clip "
                "need one focal length: does this version read EXIF?"
            )
        side = round((len(scene.cloud.means) / LAYERS) ** 0.5)
        by = max((n for n in range(1, side + 1) if side % n == 0 and side // n >= FINER * width), default=1)
        if LAYERS * side * side != len(scene.cloud.means) or by == 1:
            return scene.cloud
        return merge_clouds(scene.cloud, side=side, by=by, layers=LAYERS)

    def _draw(
        self, cloud: PlyCloud, cameras: list[Camera], reference: np.ndarray | None, started: float
    ) -> LiftedFrame:
        """Draw the frame's views, its depths scaled to the ``reference`` on still pixels."""
        blur = self.sharp.blur_px2
        front = build_point_cloud(cloud, [self.camera], blur_px2=blur)
        scale, residual = (1.0, 0.0) if reference is None else align_depths(front, reference, self.still)
        moved = replace(cloud, means=scale * cloud.means, scales=scale * cloud.scales)
        shown = build_point_cloud(moved, cameras, blur_px2=blur)
        alignment = {"scale": scale, "residual": residual, "seconds": time.monotonic() - started}
        cover = np.round(255 * shown.cover.clip(0, 1)).astype(np.uint8)
        return LiftedFrame(shown.images, cover, np.float32(scale) * front.depth[0], alignment)


def align_depths(
    front: PointCloudScene, reference: np.ndarray, still: Bool[np.ndarray, "H W"]
) -> tuple[float, float]:
    """Scale a frame's depths to the reference on still pixels.

    Returns the factor and the median relative difference left; 1 and 0 if no pixel can be compared.
    """
    known = still & (front.cover[0] > KNOWN) & (reference > 0) & (front.depth[0] > 0)
    if not known.any():
        return 1.0, 0.0
    ratio = reference[known] / front.depth[0][known]
    scale = float(np.median(ratio))
    return scale, float(np.median(np.abs(scale / ratio - 1)))


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

    ``source`` has the settings the recording was read with, ``released`` and ``states`` the simulated system
    and its true states, if it is simulated; lifted frames go to ``cache``, unless the settings name another.

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
