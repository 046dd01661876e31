"""Settings as text: what is written is read back, for every setting and preset."""

from __future__ import annotations

import pytest

from elf_runtime import PRESETS, DetectionParams, SettingError, preset
from elf_runtime.params import SETTINGS, parse_setting, setting_text, setting_value

# Of each setting values of every kind that it takes, and none of them the default.
VALUES = {
    "denoise": [(1, 0.1), (999, 1 / 3)],
    "threshold_blur": [(17, 6.0)],
    "threshold": ["none", 0.0, 1.0, 0.1 + 0.2],
    "nms_radius": [0, 123456],
    "border": [0],
    "max_keypoints": [0, 2000],
    "scale": [8.0, 1 / 3, 1e-05],
    "quantize": [True],
    "normalize": [0.95],
    "subpixel": [True],
    "mask_border": [0, 7],
    "min_contrast": [0.0, 255.0],
    "grid": [(4, 6)],
    "oriented": [True],
    "scales": [(0.9,), (0.225, 0.45, 0.9), (1 / 3, 1, 1.5, 2, 8)],
    "suppression": ["maxima"],
    "max_side": [1, 640],
}


def words(params: DetectionParams, base: DetectionParams) -> list[str]:
    """What differs from `base`, as ``NAME=VALUE``."""
    return [f"{k}={setting_text(v)}" for k, v in params.to_dict().items() if v != base.to_dict()[k]]


def read(words: list[str], base: DetectionParams) -> DetectionParams:
    return base.updated(**dict(map(parse_setting, words)))


def test_every_setting_is_here() -> None:
    assert set(VALUES) == set(SETTINGS) == set(DetectionParams().to_dict())


@pytest.mark.parametrize(("name", "value"), [(name, value) for name, values in VALUES.items() for value in values])
def test_a_setting_comes_back_to_the_last_digit(name: str, value: object) -> None:
    base = DetectionParams()
    changed = base.updated(**{name: value})
    assert setting_value(name, setting_text(value)) == getattr(changed, name) == value
    (word,) = words(changed, base)
    assert read([word], base) == changed
    assert read(words(base, changed), changed) == base
    assert DetectionParams.from_dict(changed.to_dict()) == changed


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize("network", ["vgg", "superpoint", "sobel"])
def test_a_preset_comes_back(name: str, network: str) -> None:
    base, wanted = DetectionParams(), preset(name, network)
    assert read(words(wanted, base), base) == wanted


def test_scales_in_any_order_and_form_are_the_same() -> None:
    params = DetectionParams(scales=[0.9, 1, 0.45])  # type: ignore[arg-type]
    assert params.scales == (0.45, 0.9, 1.0)
    assert params.working_scales == (1.0, 0.9, 0.45)
    assert DetectionParams(scale=0.3).working_scales == (0.3,)
    assert setting_value("scales", "0.9") == (0.9,)
    assert params.updated(scales="none") == params.updated(scales=()) == DetectionParams()


def test_a_new_scale_is_the_only_one() -> None:
    several = DetectionParams(scale=0.45, scales=(0.3, 0.6))
    assert several.working_scales == (0.6, 0.3)
    assert several.updated(scale=0.5) == DetectionParams(scale=0.5)
    assert several.updated(scale=0.5, scales=(0.7,)).working_scales == (0.7,)
    assert several.updated(border=3).scales == (0.3, 0.6)


@pytest.mark.parametrize(
    ("name", "text", "reason"),
    [
        ("scales", "9", r"scales is 'none' or up to 5 different numbers in \(0, 8\], not 9"),
        ("scales", "0,0.5", "scales is 'none' or up to 5 different numbers .* not 0,0.5$"),
        ("scales", "0.5,0.5", "different numbers .* not 0.5,0.5$"),
        ("scales", "1,2,3,4,5,6", "up to 5 .* not 1,2,3,4,5,6$"),
        ("scales", "0.5,none", "not 0.5,none$"),
        ("scales", "all", "not 'all'$"),
        ("scales", "true", "not True$"),
        ("speed", "3", "unknown detection setting 'speed'"),
        ("scale", "fast", r"scale is a number in \(0, 8\], not 'fast'"),
        ("denoise", "5", r"denoise is \(mu, sigma\) with mu odd"),
        ("nms_radius", "2.0", "nms_radius is an integer >= 0, not 2.0"),
        ("grid", "4,0", r"grid is \(rows, columns\), integers >= 1, not 4,0$"),
    ],
)
def test_what_is_no_setting_or_value_is_named(name: str, text: str, reason: str) -> None:
    with pytest.raises(SettingError, match=reason):
        setting_value(name, text)
