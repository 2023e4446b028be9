"""Recordings of flights in virtual time."""

import os
import subprocess
import sys
from pathlib import Path

from jezero.recording import open_recording
from jezero.schemas import topics
from jezero.schemas.goals import MoveResult, TakeoffGoal
from jezero.trials.flight import fly_virtually

FLY = """
import sys
from pathlib import Path
from jezero.schemas import topics
from jezero.schemas.goals import TakeoffGoal
from jezero.trials.flight import fly_virtually

fly_virtually(((topics.TAKEOFF, TakeoffGoal(altitude_m=2.0), 1.0),), 3, Path(sys.argv[1]))
"""


def test_two_processes_record_the_same_bytes_for_the_same_seed(tmp_path: Path) -> None:
    paths = [tmp_path / "a.mcap", tmp_path / "b.mcap"]
    for hash_seed, path in enumerate(paths, 1):
        environment = {**os.environ, "PYTHONHASHSEED": str(hash_seed)}
        subprocess.run((sys.executable, "-c", FLY, str(path)), env=environment, check=True)
    first, second = (path.read_bytes() for path in paths)
    assert len(first) > 100_000
    assert first == second


def test_the_goals_of_a_flight_are_in_its_recording(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    fly_virtually(((topics.TAKEOFF, TakeoffGoal(altitude_m=2.0), 1.0),), 3, path)
    (goal,) = open_recording(path).goals()
    assert isinstance(goal.goal, TakeoffGoal) and goal.goal.altitude_m == 2.0
    assert goal.outcome == "succeeded" and isinstance(goal.result, MoveResult)
    assert 2.0 < goal.duration_s < 10.0 and goal.start_ns <= goal.feedback[0].t_ns
    assert goal.feedback[0].feedback.distance_m > goal.feedback[-1].feedback.distance_m
