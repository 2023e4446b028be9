"""Table of the allowed transitions between status codes. Source: spec §3, thesis Table 3.1."""

from jezero.schemas.commands import Phase
from jezero.schemas.state import StatusCode as Code

REPORT_MIN_S = 0.1
"""A code that only reports an event lasts at least this long, so that every subscriber gets it."""
AFTER: dict[Code, tuple[Code, ...]] = {
    Code.IDLE: (Code.TAKEOFF, Code.EXTERNAL),
    Code.TAKEOFF: (Code.TAKEOFF_DONE, Code.GO_TO, Code.ABORT, Code.EXTERNAL),
    Code.TAKEOFF_DONE: (Code.HOVER, Code.EXTERNAL),
    Code.HOVER: (Code.GO_TO, Code.GET_IMAGES, Code.LANDING, Code.COVERAGE, Code.ACTION, Code.EXTERNAL),
    Code.GO_TO: (Code.GO_TO_DONE, Code.ABORT, Code.EXTERNAL),
    Code.GO_TO_DONE: (Code.HOVER, Code.EXTERNAL),
    Code.GET_IMAGES: (Code.GET_IMAGES_DONE, Code.ABORT, Code.EXTERNAL),
    Code.GET_IMAGES_DONE: (Code.HOVER, Code.EXTERNAL),
    Code.LANDING: (Code.LANDING_DONE, Code.ABORT, Code.EXTERNAL),
    Code.LANDING_DONE: (Code.IDLE, Code.EXTERNAL),
    Code.COVERAGE: (Code.COVERAGE_DONE, Code.ABORT, Code.EXTERNAL),
    Code.COVERAGE_DONE: (Code.HOVER, Code.EXTERNAL),
    Code.ACTION: (Code.ACTION_DONE, Code.ABORT, Code.EXTERNAL),
    Code.ACTION_DONE: (Code.HOVER, Code.EXTERNAL),
    Code.ABORT: (Code.HOVER, Code.IDLE, Code.EXTERNAL),
    Code.EXTERNAL: (Code.IDLE, Code.HOVER),
}

CODE_OF: dict[Phase, Code] = {
    Phase.TAKEOFF: Code.TAKEOFF,
    Phase.GO_TO: Code.GO_TO,
    Phase.GET_IMAGES: Code.GET_IMAGES,
    Phase.LANDING: Code.LANDING,
    Phase.COVERAGE: Code.COVERAGE,
    Phase.ACTION: Code.ACTION,
}
"""Code while a goal is in a phase; the next integer means that the phase is completed."""

IN_PROGRESS: tuple[Code, ...] = tuple(CODE_OF.values())


class TransitionError(RuntimeError):
    """A transition that the table doesn't allow: a bug."""


def is_allowed(before: Code, after: Code) -> bool:
    """Whether `after` may directly follow `before`; a code never follows itself."""
    return after in AFTER[before]


def require(before: Code, after: Code) -> None:
    """Raise TransitionError unless `after` may directly follow `before`."""
    if not is_allowed(before, after):
        raise TransitionError(f"{before.name} to {after.name}")


def completed(code: Code) -> Code:
    """Code of a completed phase, from the code of the phase in progress (one of `IN_PROGRESS`)."""
    return Code(code + 1)
