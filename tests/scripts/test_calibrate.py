"""qcar calibrate: what it prints and writes, and what it refuses."""

import json

import pytest

from qcar_env.commands import calibrate


@pytest.mark.slow
def test_it_reports_residuals_and_flatness(tmp_path, capsys):
    assert calibrate.main(["--omegas", "50", "60", "--out", str(tmp_path)]) == 0
    text = capsys.readouterr().out
    assert "root mean square residual: preset 6.3 %" in text
    assert "Many sets match the table" in text
    written = json.loads((tmp_path / "calibration.json").read_text(encoding="utf-8"))
    assert [row["omega"] for row in written["profile"]] == [50.0, 60.0]
    assert all(row["rms"] < 0.07 for row in written["profile"])
    assert written["preset"]["b1"] == 8.7
