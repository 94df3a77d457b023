"""qcar figures: what it writes, in which order, and what it refuses."""

import csv

import matplotlib.image
import numpy as np
import pytest

from qcar_env.analysis.paper.experiments import EFFECTS
from qcar_env.commands import figures


def run(out, *arguments):
    return figures.main([*arguments, "--out", str(out)])


@pytest.fixture(scope="module")
def some(tmp_path_factory):
    """Make a few figures, the quick way."""
    out = tmp_path_factory.mktemp("figures") / "new"
    assert run(out, "--only", "4", "11", "table1", "--quick") == 0
    return out


def test_each_figure_is_a_picture_and_a_vector(some):
    assert sorted(path.name for path in some.iterdir()) == [
        "captions.md",
        "figure-04.pdf",
        "figure-04.png",
        "figure-11.pdf",
        "figure-11.png",
        "table1.csv",
    ]
    assert (some / "figure-04.pdf").read_bytes().startswith(b"%PDF")


def test_pictures_are_of_print_size_and_not_blank(some):
    for name in ("figure-04.png", "figure-11.png"):
        pixels = matplotlib.image.imread(some / name)
        assert pixels.shape[1] == 1440  # 7.2 in over both columns at 200 dots an inch
        assert 0.01 < np.mean(pixels[:, :, :3] < 0.5) < 0.5


def test_captions_give_parameters_and_differences(some):
    text = (some / "captions.md").read_text(encoding="utf-8")
    assert text.index("## Figure 4") < text.index("## Figure 11") < text.index("## Table 1")
    assert text.count("omega1 = 55, omega2 = 55") == 3
    assert text.count("calibrated, not the authors' values") == 3
    assert "was not found" in text  # Fig. 4: the unstable left branch


def test_a_later_run_keeps_the_other_captions(some):
    assert run(some, "--only", "10", "--quick") == 0
    text = (some / "captions.md").read_text(encoding="utf-8")
    assert text.index("## Figure 4") < text.index("## Figure 10") < text.index("## Figure 11")


def test_the_same_figure_gives_the_same_file(some, tmp_path):
    assert run(tmp_path, "--only", "4", "--quick") == 0
    for name in ("figure-04.png", "figure-04.pdf"):
        assert (tmp_path / name).read_bytes() == (some / name).read_bytes()


def test_table_1_has_all_cells(some):
    with (some / "table1.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 12
    assert rows[-1]["law"] == "CNVC"
    assert float(rows[-1]["percentage error [%]"]) == pytest.approx(2807, abs=5)


def test_every_figure_of_the_paper_is_there():
    assert [name for name in figures.FIGURES if name.isdigit()] == [str(n) for n in range(3, 15)]
    # the panels of the captions of Figures 5 to 8: A-G, A-I, A-M, A-G
    assert [len(effects.claims) for effects in EFFECTS] == [7, 9, 13, 7]


def test_unknown_names_are_refused_before_anything_is_written(tmp_path, capsys):
    out = tmp_path / "none"
    assert run(out, "--only", "4", "15") == 2
    assert "unknown figure '15'" in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.slow
def test_all_figures_are_made(tmp_path, capsys):
    assert run(tmp_path) == 0
    assert len(list(tmp_path.glob("*.png"))) == len(figures.FIGURES) == 16
    assert len(list(tmp_path.glob("*.pdf"))) == 16
    assert "s left" in capsys.readouterr().out
