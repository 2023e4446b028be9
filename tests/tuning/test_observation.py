"""Which innovations of a replay count."""

from jezero.tuning.observation import settled
from tests.tuning.rig import an_innovation


def test_innovations_count_only_where_the_state_is_as_certain_as_usual() -> None:
    """After the start of the filter, and after a restart, it is not."""
    stds = [4.0, 1.0, 0.2, *[0.03] * 20, 4.0, *[0.03] * 20]
    innovations = [an_innovation(i, [0.0], std_state=std) for i, std in enumerate(stds)]
    kept = settled(innovations)
    assert len(kept) == 40
    assert {each.cov[0, 0] for each in kept} == {innovations[-1].cov[0, 0]}
    assert settled([]) == []
