"""The fidelity report on the site is what the command writes."""

import re
from pathlib import Path

import pytest

from scripts import fidelity

PAGE = Path(__file__).parents[2] / "docs" / "fidelity.md"


def numbers_masked(text: str) -> str:
    """Return the text without digits and signs: what does not depend on the last bit."""
    return re.sub(r"[-+0-9.]+", "#", text)


@pytest.mark.slow
def test_the_page_is_up_to_date(tmp_path):
    out = tmp_path / "docs" / "page.md"
    assert fidelity.main(["--out", str(out)]) == 0
    assert numbers_masked(out.read_text("utf-8")) == numbers_masked(PAGE.read_text("utf-8"))


def test_the_page_has_every_part():
    text = PAGE.read_text(encoding="utf-8")
    for title in (
        "Table 1, cell by cell",
        "How the preset was calibrated, and how flat the fit is",
        "Trends of section 5.2, row by row",
        "Claims",
        "Errata of the printed paper",
        "What the paper leaves unstated",
    ):
        assert f"\n## {title}\n" in text
    trends = text.split("## Trends")[1].split("\n## ")[0]
    assert len(re.findall(r"^\| Fig\. ", trends, flags=re.MULTILINE)) == 35
    table = text.split("## Table 1")[1].split("\n## ")[0]
    assert len(re.findall(r"\| x[12] \|", table)) == 12


def test_bad_input(tmp_path, capsys):
    assert fidelity.main(["--preset", "paper-step", "--out", str(tmp_path / "page.md")]) == 2
    assert "needs a harmonic road" in capsys.readouterr().err
    assert not (tmp_path / "page.md").exists()
