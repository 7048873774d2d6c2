"""Flow, layer time and least speed of the filament, as slicers write them."""

import pytest

from hframe_post.gcode.limits import SlicerSettings, slicer_settings

ORCA = b"""G1 X1
; filament_max_volumetric_speed = 23,12
; max_volumetric_extrusion_rate_slope = 0
; slow_down_layer_time = 6,8
; slow_down_min_speed = 10,20
"""
PRUSA = b"; filament_max_volumetric_speed = 0\n; max_volumetric_speed = 0\n" \
    b"; slowdown_below_layer_time = 5\n"  # fmt: skip
CURA = (  # cut within a name
    b';SETTING_3 {"extruder_quality": ["[values]\\\\ncool_min_lay\n'
    b';SETTING_3 er_time = 3\\\\nspeed_print = 60.0\\\\n"]}\n'
)


@pytest.mark.parametrize(("text", "found"), [
    (ORCA, SlicerSettings(12.0, 8.0, 20.0)),
    (PRUSA, SlicerSettings(None, 5.0)),
    (CURA, SlicerSettings(None, 3.0)),
    (b"; slow_down_layer_time = x\nG1 X1 ; slow_down_layer_time = 3\n", SlicerSettings()),
])  # fmt: skip
def test_the_most_careful_value_counts(text: bytes, found: SlicerSettings) -> None:
    assert slicer_settings(text.splitlines(keepends=True)) == found
