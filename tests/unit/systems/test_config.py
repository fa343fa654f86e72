import pytest


@pytest.mark.parametrize("name", ["toy", "krauss_1seg", "krauss_2seg"])
def test_the_choices_of_conf_are_valid(load, name):
    config = load(name)
    assert config.dt_s == pytest.approx(1001 / 60000, rel=1e-12)
    assert config.arm.chamber_offset < config.arm.half_width


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"n_frames": 225}, r"n_frames=225 must exceed .* = 225, to leave driven frames"),
        ({"tail_frames": 0}, "tail_frames"),
        ({"height": 4}, "height=4 must be at least 8"),
        ({"drive_high_hz": 40.0}, "half the frame rate"),
        ({"drive_low_hz": 3.0}, "between drive_low_hz=3.0"),
        ({"hold_atm": [0.1]}, "two pressures for each of 1 segments"),
        ({"hold_atm": [0.1, 2.0]}, "drive_max_atm"),
        ({"camera_noise_levels": -1.0}, "camera_noise_levels"),
        ({"dt_s": 0.0}, "dt_s"),
        ({"rtol": 0.0}, "rtol"),
        ({"view_width": 0.0}, "view_width"),
        ({"arm": {"mass": [0.1, 0.2]}}, r"arm.mass=.* needs a value for each of the 1 segments"),
        ({"arm": {"mass": [-0.1]}}, "arm.mass"),
        ({"arm": {"chamber_limit": 1.5}}, "chamber_limit"),
        ({"arm": {"half_width": 0.0}}, "half_width"),
        ({"arm": {"retardation_s": -0.1}}, "retardation_s"),
    ],
)
def test_nonsense_is_refused_with_its_name(load, changes, message):
    with pytest.raises(ValueError, match=message):
        load("toy", **changes)
