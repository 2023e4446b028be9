"""The commands of `jezero` by section: where each is, what it needs, and its line in the help."""

from collections.abc import Sequence
from typing import NamedTuple


class Listed(NamedTuple):
    """One command.

    Attributes:
        module: in which its function is.
        name: of the function.
        summary: its line in the help.
        extras: extras of jezero, separated by commas, with all packages that the command needs.
        when: word of the command line without which the extra `cli` is enough; "" where they are always needed.
    """

    module: str
    name: str
    summary: str
    extras: str = "cli"
    when: str = ""

    def extras_for(self, words: Sequence[str]) -> str:
        """Extras that a command line needs: less than all packages where it starts or does a part only."""
        if self.name == "up" and "--profile" in words and "sim" not in words:
            return "services"
        return self.extras if not self.when or self.when in words else "cli"


SECTIONS: dict[str, dict[str, Listed]] = {
    "Stack": {
        "up": Listed("jezero.cli.stack", "up", "Start the services (Ctrl+C stops them; -d in the background).", "sim"),
        "down": Listed("jezero.cli.stack", "down", "Stop the services."),
        "ps": Listed("jezero.cli.stack", "ps", "Show the state and health of the services."),
        "logs": Listed("jezero.cli.stack", "logs", "Show the output of the services."),
        "install-service": Listed(
            "jezero.cli.install_service", "install_service", "Start a stack at boot, by a systemd unit."
        ),
        "info": Listed("jezero.cli.info", "info", "Show the declared services and topics."),
        "keys": Listed("jezero.cli.keys", "keys", "Make the certificates of a team's computers and people."),
    },
    "Flight": {
        "preflight": Listed("jezero.cli.flight", "preflight", "Check what a pilot checks before a takeoff."),
        "takeoff": Listed("jezero.cli.flight", "takeoff", "Take off."),
        "target": Listed("jezero.cli.flight", "target", "Fly to a point."),
        "velocity": Listed("jezero.cli.flight", "velocity", "Fly at a velocity, until Ctrl+C or for a time."),
        "land_on_spot": Listed("jezero.cli.flight", "land_on_spot", "Land."),
        "return": Listed("jezero.cli.flight", "return_home", "Fly home and land, on the rover if it is known."),
        "hover": Listed("jezero.cli.flight", "hover", "Hover here, or at a point."),
        "pause": Listed("jezero.cli.flight", "pause", "Pause the goal in charge: hover until it is resumed."),
        "resume": Listed("jezero.cli.flight", "resume", "Go on with the paused goal in charge."),
        "modify": Listed("jezero.cli.flight", "modify", "Change fields of the goal in charge, such as its speed."),
        "abort": Listed("jezero.cli.flight", "abort", "End the goal in charge and hover."),
        "kill": Listed("jezero.cli.flight", "kill", "Stop the motors at once, also in the air."),
        "action": Listed("jezero.cli.flight", "action", "List all actions, or send a goal to any of them."),
        "status": Listed("jezero.cli.flight", "status", "Show what the vehicle does, and where it is."),
        "rover": Listed("jezero.cli.flight", "rover", "Drive the rover."),
        "ground": Listed(
            "jezero.cli.ground", "ground", "Serve the ground station's pages alone (--connect).", "ground"
        ),
        "camera": Listed(
            "jezero.cli.camera",
            "camera",
            "Save images of the camera, and calibrate it.",
            "sim",
            "orthophoto",
        ),
    },
    "Simulator": {
        "sim": Listed("jezero.cli.sim", "sim", "Play with the simulated world: pause, place, wind, faults."),
    },
    "Hardware": {
        "twin": Listed("jezero.cli.twin", "twin", "Run a simulated vehicle as hardware would be, to rehearse.", "sim"),
        "px4": Listed("jezero.cli.px4", "px4", "Compare and set a real flight controller's parameters.", "services"),
        "uwb": Listed("jezero.cli.uwb", "uwb", "Test the UWB ranges, and find the places of the anchors.", "services"),
        "tag": Listed("jezero.cli.tag", "tag", "Print the tags on the rover's platform.", "report"),
    },
    "Other tools": {
        "ros2": Listed("jezero.cli.ros2", "ros2", "Show the vehicle in ROS 2."),
    },
    "Missions": {
        "fence": Listed("jezero.cli.missions", "fence", "Set the places to stay in and out of."),
        "mission": Listed(
            "jezero.cli.missions", "mission", "Check a mission file, fly it, and command it in flight.", "sim", "check"
        ),
    },
    "Survey": {
        "getimages": Listed("jezero.cli.survey", "getimages", "Take images of a target from all sides."),
        "gridsweep": Listed(
            "jezero.cli.survey",
            "gridsweep",
            "Take images of an area in lines (--plan-only: draw the plan).",
            "services",
            "--plan-only",
        ),
        "map": Listed("jezero.cli.survey", "map_", "Make a map from the images of gridsweep.", "services"),
    },
    "Records": {
        "watch": Listed(
            "jezero.cli.records", "watch", "Serve the messages to a viewer, live (--foxglove).", "foxglove"
        ),
        "recording": Listed("jezero.cli.records", "recording", "Look into recordings, cut, repair and export them."),
        "replay": Listed(
            "jezero.cli.replay",
            "replay",
            "Replay a recording (--through: through one of its services).",
            "services",
            "--through",
        ),
        "tune": Listed(
            "jezero.cli.tune",
            "tune",
            "Find the estimator's noise settings that fit recorded flights.",
            "services,report",
        ),
        "report": Listed("jezero.cli.records", "report", "Draw the figures of recorded flights.", "services,report"),
    },
    "Demonstration": {
        "fly": Listed(
            "jezero.cli.demonstration",
            "fly",
            "Fly to two points and land on the rover (--fast: in virtual time).",
            "sim",
            "--fast",
        ),
        "demo": Listed("jezero.cli.demonstration", "demo", "Fly the thesis' mission: images, a map, a landing.", "sim"),
    },
    "Development": {
        "new": Listed("jezero.cli.new", "new", "Write the package of a new action."),
    },
    "Tests": {
        "campaign": Listed("jezero.cli.trials", "campaign", "Fly missions with seeded faults in virtual time.", "sim"),
        "bench": Listed(
            "jezero.cli.trials", "bench", "Land many times in virtual time and measure the accuracy.", "sim"
        ),
    },
}
COMMANDS = {name: entry for section in SECTIONS.values() for name, entry in section.items()}
