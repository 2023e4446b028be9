"""Missions and fences from files in YAML or JSON, with every mistake named by its line.

```python
from jezero import Vehicle
from jezero.mission_files import read_mission

with Vehicle.connect("uav1") as uav:
    uav.mission.run(read_mission("survey.yaml").mission)
```
"""

from jezero.base.extras import require

require("jezero.mission_files", "yaml")

from jezero.mission_files.fence_file import configured_fence, read_fence
from jezero.mission_files.planning import StepPlan, plan_mission
from jezero.mission_files.problems import MissionFileError, Problem
from jezero.mission_files.reader import MissionFile, read_mission
from jezero.mission_files.shipped import shipped_file, shipped_mission, shipped_names

__all__ = [
    "MissionFile", "MissionFileError", "Problem", "StepPlan", "configured_fence", "plan_mission", "read_fence",
    "read_mission", "shipped_file", "shipped_mission", "shipped_names",
]  # fmt: skip
