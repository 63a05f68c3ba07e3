"""The keys of a camera."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from plotfeed.feeds.scene.fields import Azimuth, Elevation, Name, Site
from plotfeed.feeds.scene.sensors.mount_keys import MountKeys
from plotfeed.feeds.scene.sensors.scan_keys import Scan
from plotfeed.feeds.scene.sensors.sensor_keys import Reports, SensorGeometry, SensorKeys
from plotfeed.models import optics
from plotfeed.models.beam import AzimuthCover
from plotfeed.models.sensors.camera import UNRECOGNISED, Camera, HotSpot, LostContrast
from plotfeed.models.state import DRONE

# Above this field of view a picture has equal angles a pixel; flat ones bend too much.
PANORAMA_DEG = 120.0
Cycles = Annotated[float, Field(ge=0.01, le=1000)]
Contrast = Annotated[float, Field(gt=0, le=1)]
Pixels = Annotated[int, Field(ge=16, le=1_000_000)]
NO_LIMIT_M = 1e9


class CameraKeys(SensorKeys):
    """A camera, of light or of heat, whose pictures are searched for drones."""

    label = "camera"
    geometry = SensorGeometry.BEARINGS
    sapient_type = "CAMERA"
    formats = ("asterix-015", "asterix-205", "plots", "sapient")
    usual = ("asterix-015", "plots")
    makes = Camera
    tells_models = True  # where it sees enough of a drone

    type: Literal["camera"]
    report: Reports = ()
    """Without it, the first and plots; both ASTERIX formats bring 025 along."""
    scan: Scan
    """One picture; of a panoramic camera that turns, one turn."""
    pan_deg: Azimuth = 0.0
    """Where the middle of the picture is, from true north."""
    tilt_deg: Elevation = 0.0
    """Where the middle of the picture is, above the horizon."""
    horizontal_fov_deg: Annotated[float, Field(ge=0.01, le=360)]
    """Whole field of view; above 120 the picture is a panorama."""
    vertical_fov_deg: Annotated[float, Field(ge=0.01, le=180)] | None = None
    """Whole field of view; without it, that of square pixels."""
    pixels_across: Pixels
    """Of a picture. Those of a digital zoom are no more than these."""
    pixels_down: Pixels
    """Of a picture."""
    range_max_m: Annotated[float, Field(gt=0, le=100_000)]
    """Nothing further is looked at, however large."""
    detect_cycles: Cycles = 1.0
    """Cycles (pairs of pixels) across a drone for a Pd of 0.5."""
    recognise_factor: Annotated[float, Field(ge=1, le=100)] = 4.0
    """So many times that for its class, such as drone or bird."""
    identify_factor: Annotated[float, Field(ge=1, le=100)] = 6.4
    """So many times that for its model."""
    tells_apart: Annotated[tuple[Name, ...], Field(strict=False, min_length=1, max_length=20)] = (
        DRONE,
        "bird",
    )
    """Classes that the camera tells apart, by `target_class` of a [[drone]]."""
    class_probability: Annotated[float, Field(ge=0, le=1)] = 0.95
    """That a claimed class is right; else it is another of `tells_apart`."""
    pointing_error_deg: Annotated[float, Field(ge=0, le=10)] = 0.05
    """Standard deviation of the mount's pointing, anew for each plot."""
    pixel_error: Annotated[float, Field(ge=0, le=100)] = 0.4
    """Standard deviation of the place in the picture, in pixels."""
    false_alarms_per_frame: Annotated[float, Field(ge=0, le=10_000)] = 0.01
    """Mean number in a picture, or in a turn."""
    day_contrast: Contrast | None = None
    """Of drones beside the sky."""
    night_contrast: Contrast | None = None
    """The same at night; without it, as by day."""
    night: bool = False
    """Whether it is night; an event or control can change it."""
    threshold_contrast: Contrast = 0.02
    """That is needed for the coarsest detail."""
    nyquist_contrast: Contrast = 0.3
    """That is needed for the finest that pixels can hold."""
    visibility_m: Annotated[float, Field(ge=10, le=1e6)] | None = None
    """Meteorological optical range: where a twentieth of contrast is left; without it, clear."""
    hotter_k: Annotated[float, Field(gt=0, le=1000)] | None = None
    """Of drones than their background; spots smaller than a pixel are detected."""
    mount: MountKeys | None = None
    """Motors that turn the camera to cues, and home; without it, fixed."""
    netd_mk: Annotated[float, Field(ge=1, le=10_000)] = 50.0
    """Noise of a pixel of heat; some 50 mK without a cooler, 20 to 25 with one."""

    def _refusals(self) -> Iterator[str]:
        if self.scan.rotates and self.horizontal_fov_deg < 360:
            yield "scan.kind: a camera turns to see all around: horizontal_fov_deg 360"
        if self.mount is not None and (self.scan.rotates or self.is_panoramic):
            yield "mount: only of a camera with flat pictures that does not turn"
        if self.nyquist_contrast <= self.threshold_contrast:
            yield "nyquist_contrast: must be above threshold_contrast"
        if UNRECOGNISED in self.tells_apart:
            yield f"tells_apart: {UNRECOGNISED!r} is what is not recognised"
        if len(set(self.tells_apart)) < len(self.tells_apart):
            yield "tells_apart: one is there twice"

    @property
    def is_panoramic(self) -> bool:
        """Whether pictures have equal angles a pixel."""
        return self.horizontal_fov_deg > PANORAMA_DEG

    @property
    def vertical_field_deg(self) -> float:
        """The vertical field of view, that of square pixels if it is not given."""
        if self.vertical_fov_deg is not None:
            return self.vertical_fov_deg
        if self.is_panoramic:
            return min(self.horizontal_fov_deg * self.pixels_down / self.pixels_across, 180.0)
        angle_rad = optics.pixel_angle_rad(self.horizontal_fov_deg, self.pixels_across)
        return float(optics.field_of_pixels_deg(angle_rad, self.pixels_down))

    @property
    def azimuth_min_deg(self) -> float:
        """Where the picture begins, or what a mount can see."""
        return -180.0 if self.mount else self.pan_deg - self.horizontal_fov_deg / 2

    @property
    def azimuth_max_deg(self) -> float:
        """Where the picture ends."""
        return 180.0 if self.mount else self.pan_deg + self.horizontal_fov_deg / 2

    @property
    def elevation_min_deg(self) -> float:
        """Lowest elevation in the picture, or that a mount can have in it."""
        lowest_deg = self.tilt_deg if self.mount is None else self.mount.tilt_min_deg
        return max(lowest_deg - self.vertical_field_deg / 2, -90.0)

    @property
    def elevation_max_deg(self) -> float:
        """Highest elevation in the picture, likewise."""
        highest_deg = self.tilt_deg if self.mount is None else self.mount.tilt_max_deg
        return min(highest_deg + self.vertical_field_deg / 2, 90.0)

    @property
    def classes(self) -> tuple[str, ...]:
        """Classes that it tells apart, behind the one of what it does not recognise."""
        return (UNRECOGNISED, *self.tells_apart)

    def following(self, site: Site, /) -> dict[str, Any]:
        """Cover, cycles and contrasts, with its mount's home as what it looks along."""
        pixels = float(self.pixels_across) * self.pixels_down
        visibility_m = self.visibility_m or NO_LIMIT_M
        steered = self.mount is not None
        pan_deg, half_deg = 0.0 if steered else self.pan_deg, self.horizontal_fov_deg / 2
        hot_spot = None
        if self.hotter_k is not None:
            hot_spot = HotSpot(
                warmer_k=self.hotter_k, noise_k=self.netd_mk / 1000, visibility_m=visibility_m
            )
        return super().following(site) | {
            "pfa": self.false_alarms_per_frame / pixels,
            "pan_deg": pan_deg,
            "tilt_deg": 0.0 if steered else self.tilt_deg,
            "azimuth_cover": AzimuthCover(pan_deg - half_deg, pan_deg + half_deg),
            "vertical_fov_deg": self.vertical_field_deg,
            "pixels_across": float(self.pixels_across),
            "pixels_down": float(self.pixels_down),
            "panoramic": self.is_panoramic,
            "steered": steered,
            "classes": self.tells_apart,
            "recognise_cycles": self.detect_cycles * self.recognise_factor,
            "identify_cycles": self.detect_cycles * self.identify_factor,
            "contrast": self._contrast(visibility_m),
            "hot_spot": hot_spot,
        }

    def _contrast(self, visibility_m: float) -> LostContrast | None:
        inherent = self.day_contrast
        if self.night and self.night_contrast is not None:
            inherent = self.night_contrast
        if inherent is None and self.visibility_m is None:
            return None
        return LostContrast(
            inherent=1.0 if inherent is None else inherent,
            threshold=self.threshold_contrast,
            at_nyquist=self.nyquist_contrast,
            visibility_m=visibility_m,
        )

    def warnings(self, _site: Site, /) -> Iterator[str]:
        """Pictures that are no lens's, and a night without its contrast."""
        if not self.is_panoramic:
            square = np.tan(np.radians(self.vertical_field_deg) / 2) * self.pixels_across
            square /= np.tan(np.radians(self.horizontal_fov_deg) / 2) * self.pixels_down
            if not 0.8 < square < 1.25:
                yield f"vertical_fov_deg: pixels are {square:.2g} times as high as they are wide"
        if self.night and self.night_contrast is None:
            yield "night changes nothing: night_contrast is not given"
