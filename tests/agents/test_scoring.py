import pytest

pytest.importorskip("torch")

import numpy as np

from qcar_env.agents import scoring
from qcar_env.control import CNVC
from qcar_env.evaluation.tracks import TRACKS, episodes


def test_scores_agree_with_the_environment():
    track = TRACKS["paper"]
    found = scoring.reference("cnvc", track, 1.0)
    # CNVC sampled at 200 Hz; the continuous law leaves 0.1152 and 0.0547 m
    np.testing.assert_allclose(found.amplitudes[0], (0.1152, 0.0547), rtol=0.05)
    assert scoring.optimum(track.at(0.5)) == pytest.approx(0.167, rel=0.02)


@pytest.mark.parametrize(
    ("drawn", "duration", "message"),
    [
        ([], None, "episodes must not be empty; give at least one"),
        (None, 0.0, "duration must be positive, got 0 s; give a value above 0 s"),
        (None, 1e-3, "duration must hold a control interval, got 0.001 s with dt = 0.005 s; give"),
    ],
)
def test_a_score_of_nothing_is_refused(drawn, duration, message):
    track = TRACKS["paper"]
    if drawn is None:
        drawn = episodes(track, "validation", force_scale=1.0, count=1)
    policy = scoring.VelocityPolicy(law=CNVC(), scenario=track.nominal)
    with pytest.raises(ValueError, match=message):
        scoring.run(policy, track, drawn, duration=duration)
