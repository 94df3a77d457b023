"""Roads from files: what was written comes back, and what cannot be read is named by its line."""

import math
import struct

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from qcar_env.roads import SampledRoad, load
from qcar_env.roads.samples import UNITS

in_a_folder = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])

profiles = st.lists(st.floats(-0.2, 0.2), min_size=2, max_size=30)
# uneven, but no step is ten times the median
steps = st.lists(st.floats(0.1, 0.5), min_size=3, max_size=29)


def write(path, text):
    path.write_text(text, encoding="utf-8")
    return path


def table(s, y, *, unit="m", between=", "):
    rows = [f"{a!r}{between}{b / UNITS[unit]!r}" for a, b in zip(s, y, strict=True)]
    return "\n".join([f"distance [m]{between}height [{unit}]", *rows])


def erd(heights, *, spacing=0.25, unit="mm", xunit="m", stored=5, count=None):
    rows = [" ".join(f"{each!r}" for each in row) for row in heights]
    channels = len(heights[0])
    return "\n".join(
        [
            "ERDFILEV2.00",
            f"{channels}, {count or len(heights)}, -1, 1, {stored}, {spacing!r}, -1,",
            "TITLE   a road",
            "SHORTNAM" + "".join(f"{name:8}" for name in ("LElev.", "RElev.")[:channels]),
            "UNITSNAM" + f"{unit:8}" * channels,
            f"XUNITS  {xunit}",
            "END",
            *(rows if stored == 5 else []),
        ]
    )


@in_a_folder
@given(y=profiles, unit=st.sampled_from(list(UNITS)), between=st.sampled_from([",", "; ", "\t"]))
def test_a_table_gives_the_road_through_its_samples(tmp_path, y, unit, between):
    s = (0.25 * np.arange(len(y))).tolist()
    path = write(tmp_path / "road.csv", table(s, y, unit=unit, between=between))
    road = load(path, level=False)
    assert road.distances == tuple(s)
    assert road.samples == pytest.approx(y, rel=1e-14, abs=1e-300)
    assert load(path).samples == pytest.approx([each - y[0] for each in y], abs=1e-15)


@in_a_folder
@given(steps=steps, rise=st.floats(-0.1, 0.1))
def test_uneven_samples_are_sampled_again_at_their_median_distance(tmp_path, steps, rise):
    s = np.cumsum([0.0, 1.5 * steps[0], *steps])
    path = write(tmp_path / "road.csv", table(s.tolist(), (rise * s**2).tolist()))
    road = load(path)
    assert road.spacing == pytest.approx(np.median(np.diff(s)))
    between = np.linspace(0.0, s[-1], 77)
    # a spline keeps a parabola
    assert road.heights(between) == pytest.approx(rise * between**2, abs=1e-12)


@in_a_folder
@given(steps=steps, seed=st.integers(0, 99))
def test_straight_lines_are_straight_and_have_a_kink_at_each_sample(tmp_path, steps, seed):
    s = np.cumsum([0.0, *steps])
    y = np.random.default_rng(seed).uniform(-0.1, 0.1, s.size)
    road = load(
        write(tmp_path / "road.csv", table(s.tolist(), y.tolist())),
        interpolation="linear",
        level=False,
    )
    between = np.linspace(0.0, s[-1], 77)
    assert road.heights(between) == pytest.approx(np.interp(between, s, y), abs=1e-14)
    assert road.kinks(-1.0, 99.0) == s.tolist()


@pytest.mark.parametrize("interpolation", ["cubic", "linear"])
def test_it_is_sampled_again_at_a_spacing(tmp_path, interpolation):
    s, y = [0.0, 1.0, 2.5], [0.0, 0.1, 0.0]
    options = dict(interpolation=interpolation, spacing=0.9)  # 2.5 m: 3 intervals
    road = load(write(tmp_path / "road.csv", table(s, y)), **options)
    grid = np.linspace(0.0, 2.5, 4)
    bend = -0.1 / 1.5  # of the parabola through the three samples, (s - 2.5) s bend
    expected = np.interp(grid, s, y) if interpolation == "linear" else bend * grid * (grid - 2.5)
    assert road.heights(grid) == pytest.approx(expected, abs=1e-15)
    assert len(road.kinks(-1.0, 9.0)) == (4 if interpolation == "linear" else 2)


def test_a_road_begins_where_it_is_put(tmp_path):
    path = write(tmp_path / "road.csv", table([478.0, 478.5, 479.0], [583.0, 583.1, 583.2]))
    road = load(path, start=5.0)
    assert road.kinks(0.0, 99.0) == [5.0, 6.0]
    assert road.heights([0.0, 5.5]) == pytest.approx([0.0, 0.1], abs=1e-12)
    assert load(path).kinks(0.0, 999.0) == [478.0, 479.0]
    assert load(path, level=False).heights(0.0) == 583.0


def test_comments_blank_lines_quotation_marks_and_a_byte_order_mark_are_passed_over(tmp_path):
    text = '\ufeff# a road\n"Distance [m]", "left, inner [mm]"\r\n\n0,1\n0.5,2\n\n# end\n1.0,3\n\n'
    road = load(write(tmp_path / "road.txt", text))
    assert road.distances == (0.0, 0.5, 1.0)
    assert road.samples == pytest.approx((0.0, 1e-3, 2e-3))


def test_one_of_several_columns_is_chosen(tmp_path):
    text = "left [mm], distance [ft], right [in]\n0, 0, 0\n5, 1, 1\n5, 2, 2\n"
    path = write(tmp_path / "road.csv", text)
    assert load(path, channel="left").samples == pytest.approx((0.0, 0.005, 0.005))
    assert load(path, channel="right").samples == pytest.approx((0.0, 0.0254, 0.0508))
    assert load(path, channel="right").distances == pytest.approx((0.0, 0.3048, 0.6096))
    for channel in (None, "middle"):
        with pytest.raises(ValueError, match=r"'left', 'right', got .*; give channel="):
            load(path, channel=channel)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (["0,1", "0,5,2"], "a line must have 2 cells, got 3 in line 3 of {}: '0, 5, 2'; write one"),
        (["0,1", ""], "{} must hold two or more samples, got 1; give a longer profile"),
        ([], "{} must hold two or more samples, got 0"),
        (["0,1", "1,", "2,3"], "height must be a finite number, got '' in line 3 of {}; fill the"),
        (["0,1", "1,up"], "height must be a finite number, got 'up' in line 3 of {}; write a num"),
        (["0,1", "1,nan"], "height must be a finite number, got 'nan' in line 3 of {}; write"),
        (["0,1", "inf,1"], "distance must be a finite number, got 'inf' in line 3 of {}; write"),
        (["0,1", "1e99,1"], "distance must be finite and within 1e+09 m, got 1e+99 m in line 3"),
        (["0,1", "1,1_0"], "height must be a finite number, got '1_0' in line 3 of {}; write"),
        (["0,1", "1,2", "1,3"], "got 1 m twice, the second time in line 4 of {}; keep one of"),
        (["0,1", "2,2", "1,3"], "got 1 m after 2 m in line 4 of {}; sort the samples"),
        (["0,1", "1,2", "2,1", "40,3"], "got a gap from 2 to 40 m in line 5 of {}; fill it in, or"),
        (['0,"1', "1,2"], "line 2 of {} must be cells with ',' between them, got"),
    ],
)
def test_bad_rows_are_refused_with_line_and_remedy(tmp_path, lines, message):
    path = write(tmp_path / "road.csv", "\n".join(["distance [m], height [mm]", *lines]))
    with pytest.raises(ValueError) as error:  # noqa: PT011  the message is compared below
        load(path)
    assert message.format(path) in str(error.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "{} must hold samples, got an empty file; give a table of them"),
        ("0,1\n1,2", "must name each column and its unit in brackets, got '0' in line 1 of {};"),
        ("distance, height\n0,1", "its unit in brackets, got 'distance' in line 1 of {}; write a"),
        ("distance [m], height [furlong]\n0,1", "unit of 'height' must be one of m, km, cm, mm"),
        ("x [m], y [m]\n0,1", "one column must be named 'distance' and another one be heights"),
        ("distance [m]\n0\n1", "and another one be heights, got ['distance'] in line 1 of {};"),
        ("distance [m]; height [m]\n0;0\n0,25;1", "got '0,25' in line 3 of {}; write a decimal po"),
    ],
)
def test_bad_tables_are_refused_with_line_and_remedy(tmp_path, text, message):
    path = write(tmp_path / "road.csv", text)
    with pytest.raises(ValueError) as error:  # noqa: PT011  the message is compared below
        load(path)
    assert message.format(path) in str(error.value)


def test_a_wide_gap_may_be_allowed(tmp_path):
    path = write(tmp_path / "road.csv", table([0.0, 1.0, 2.0, 40.0], [0.0, 1.0, 2.0, 40.0]))
    assert load(path, longest_gap=50.0).heights(20.0) == pytest.approx(20.0)


def test_what_is_no_text_is_refused(tmp_path):
    path = tmp_path / "road.csv"
    path.write_bytes(b"distance [m], h\xf6he [m]\n0,1\n1,2")
    with pytest.raises(ValueError, match="must be text in UTF-8, got the byte 0xf6 at 15; save"):
        load(path)


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("road.ppf", {}, "unknown kind of road file '.ppf'"),
        ("road.csv", {"interpolation": "cubik"}, "unknown interpolation 'cubik'; did you mean"),
        ("road.csv", {"spacing": 0.0}, "spacing must be positive, got 0 m"),
        ("road.csv", {"spacing": -1.0, "interpolation": "linear"}, "spacing must be positive"),
        ("road.csv", {"start": math.nan}, "start must be finite, got nan m"),
        ("road.csv", {"longest_gap": -1.0}, "longest_gap must be positive, got -1 m"),
        ("road.csv", {"channel": 1}, "channel must be one of the profiles of"),
    ],
)
def test_bad_options_are_refused_with_name_value_and_remedy(tmp_path, name, options, message):
    path = write(tmp_path / name, table([0.0, 1.0], [0.0, 1.0]))
    with pytest.raises(ValueError) as error:  # noqa: PT011  the message is compared below
        load(path, **options)
    assert message in str(error.value)


def test_no_file_is_no_file(tmp_path):
    with pytest.raises(FileNotFoundError):
        load(tmp_path / "none.csv")


@in_a_folder
@given(
    text=st.text(st.sampled_from("distance [m],height [mm]\n;\t#\"'0123456789.,-+eE naf_"))
    | st.lists(st.sampled_from(["0", "1", "2.5", "-1e3", "x", "", "nan", "1,5", "1e999"])).map(
        lambda cells: "distance [m], height [mm]\n" + ",".join(cells).replace("5,", "5\n")
    ),
    kind=st.sampled_from(["csv", "erd"]),
)
def test_any_text_is_a_road_or_refused(tmp_path, text, kind):
    path = write(tmp_path / f"road.{kind}", text)
    try:
        assert isinstance(load(path), SampledRoad)
    except ValueError as error:
        assert str(path) in str(error)  # noqa: PT017  a road is fine as well


@in_a_folder
@given(
    y=profiles, unit=st.sampled_from(["m", "mm", "IN", "ft"]), xunit=st.sampled_from(["m", "ft"])
)
def test_an_erd_file_gives_the_road_through_its_samples(tmp_path, y, unit, xunit):
    heights = [(each, -each) for each in y]
    path = write(tmp_path / "road.erd", erd(heights, unit=unit, xunit=xunit))
    road = load(path, channel="RElev.", level=False)
    metre = UNITS[unit.lower()]
    assert road.samples == pytest.approx([-metre * each for each in y], abs=1e-300)
    grid = 0.25 * UNITS[xunit] * np.arange(len(y))
    assert road.distances == pytest.approx(grid, rel=1e-14)


@pytest.mark.parametrize("name", ["road.erd.bin", "road.bin"])
def test_an_erd_file_with_binary_data(tmp_path, name):
    heights = [(1.0, 2.0), (3.0, 4.0), (5.0, 6.5)]
    path = write(tmp_path / "road.erd", erd(heights, stored=1))
    with pytest.raises(ValueError, match=r"must lie beside it in road.erd.bin or road.bin, got n"):
        load(path, channel="RElev.")
    (tmp_path / name).write_bytes(struct.pack("<6f", *np.ravel(heights)))
    assert load(path, channel="RElev.", level=False).samples == pytest.approx((2e-3, 4e-3, 6.5e-3))
    (tmp_path / name).write_bytes(struct.pack("<5f", *np.ravel(heights)[:5]))
    with pytest.raises(ValueError, match="must hold the 3 samples that its line 2 states, got 2"):
        load(path, channel="RElev.")


GOOD = erd([(1.0,), (2.0,), (3.0,)])


@pytest.mark.parametrize(
    ("was", "now", "message"),
    [
        ("ERDFILEV2.00", "ERD", "must begin with ERDFILEV2.00, got 'ERD' in line 1 of {}; export"),
        ("1, 3, -1", "1, x, -1", "line 2 of {} must be number of channels (1 to 1000), number"),
        ("1, 3,", "1, inf,", "line 2 of {} must be number of channels (1 to 1000), number"),
        ("2.0\n", "1e308\n", "height must be finite and within 1e+09 m, got 1e+305 m in line 9"),
        ("0.25", "1e308", "distance must be finite and within 1e+09 m, got 1e+308 m in line 9"),
        ("0.25", "-0.25", "kind of data and positive spacing, got '1, 3, -1, 1, 5, -0.25, -1,'"),
        (" 5, ", " 0, ", "kind of data must be 5 (text) or 1 (floats of 4 bytes), got 0 in line 2"),
        ("1, 3,", "1, 4,", "must hold the 4 samples that its line 2 states, got 3; it may be cut"),
        ("END", "ENDE", "the header of {} must end with a line END, got none; add it"),
        ("UNITSNAMmm", "UNITSNAMkg", "unit of 'LElev.' must be one of m, km, cm, mm, ft, in, got"),
        ("UNITSNAM", "UNITS   ", "the header of {} must have UNITSNAM, got none; add: UNITSNAMmm"),
        (
            "XUNITS  m",
            "XUNITS  s",
            "unit of 'XUNITS' must be one of m, km, cm, mm, ft, in, got 's'",
        ),
        ("XUNITS", "XLABEL", "the header of {} must have XUNITS, got none; add: XUNITS  m"),
        ("2.0\n", "2.0 2.0\n", "a line must have 1 numbers, got '2.0 2.0' in line 9 of {}; write"),
        ("2.0\n", "2.0 x\n", "a line must have 1 numbers, got '2.0 x' in line 9 of {}; write"),
        ("2.0\n", "\n", "line 9 of {} must be a sample, got none; fill it in"),
        (
            "2.0\n",
            "nan\n",
            "height must be finite and within 1e+09 m, got nan m in line 9 of {}; fill the",
        ),
    ],
)
def test_bad_erd_files_are_refused_with_line_and_remedy(tmp_path, was, now, message):
    path = write(tmp_path / "road.erd", GOOD.replace(was, now, 1))
    assert now in path.read_text()
    with pytest.raises(ValueError) as error:  # noqa: PT011  the message is compared below
        load(path)
    assert message.format(path) in str(error.value)


def surface(path, z, **options):
    crg = pytest.importorskip("pyopencrg")
    road = crg.CrgRoad(z, u_inc=0.05, v=np.array([-1.0, 0.0, 1.0]), **options)
    road.save(path, fmt="LDFI")
    return path


WEDGE = np.outer(np.linspace(0.0, 0.1, 21), [1.0, 1.0, 2.0])


def test_an_opencrg_surface_gives_the_profile_at_a_lateral_position(tmp_path):
    path = surface(tmp_path / "road.crg", WEDGE)
    assert load(path).heights([0.0, 0.5, 1.0]) == pytest.approx([0.0, 0.05, 0.1], abs=1e-12)
    # midway between two columns
    assert load(path, channel=0.5).heights(1.0) == pytest.approx(0.15, abs=1e-12)
    with pytest.raises(ValueError, match=r"must lie on the road, -1 to 1 m, got 1\.5 m; giv"):
        load(path, channel=1.5)
    with pytest.raises(ValueError, match="must be a number in m, got 'left'; give a finite"):
        load(path, channel="left")


def test_a_hole_in_an_opencrg_surface_is_refused(tmp_path):
    crg = pytest.importorskip("pyopencrg")
    z = WEDGE.copy()
    z[10, 1] = math.nan
    path = surface(tmp_path / "road.crg", z)
    with (
        pytest.warns(crg.CrgCheckWarning, match="NaN values"),
        pytest.raises(
            ValueError, match=r"height must be finite .* got nan m in cross-section 11 of"
        ),
    ):
        load(path)


def test_the_modifiers_of_an_opencrg_file_are_applied(tmp_path):
    crg = pytest.importorskip("pyopencrg")
    road = crg.read(surface(tmp_path / "road.crg", WEDGE))
    road.mods = {"scale_z_grid": 2.0}
    road.save(tmp_path / "twice.crg")
    assert load(tmp_path / "twice.crg").heights(1.0) == pytest.approx(0.2, abs=1e-6)


def test_what_is_no_opencrg_file_is_refused(tmp_path):
    pytest.importorskip("pyopencrg")
    path = write(tmp_path / "road.crg", "hello")
    with pytest.raises(ValueError, match=r"must be an OpenCRG file that passes the checks .* rep"):
        load(path)


def test_without_its_reader_an_opencrg_file_says_how_to_get_it(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pyopencrg", None)
    with pytest.raises(RuntimeError, match=r"needs pyopencrg: pip install 'qcar_env\[roads\]'"):
        load(tmp_path / "road.crg")
