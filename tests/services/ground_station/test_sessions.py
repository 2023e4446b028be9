"""Log-ins end, and wrong passwords are slow."""

from jezero.services.ground_station.sessions import ADDRESSES_MAX, SESSIONS_MAX, LoginLimiter, Sessions


def test_a_session_that_is_not_used_ends_after_its_idle_time() -> None:
    sessions = Sessions(idle_s=100.0, max_s=1000.0)
    session = sessions.begin(0.0)
    assert sessions.use(session, 60.0)
    assert sessions.remaining_s(session, 110.0) == 50.0
    assert not sessions.use(session, 160.0)
    assert sessions.remaining_s(session, 160.0) == 0.0


def test_a_session_ends_after_its_absolute_time_though_it_is_used() -> None:
    sessions = Sessions(idle_s=100.0, max_s=150.0)
    session = sessions.begin(0.0)
    assert sessions.use(session, 90.0)
    assert sessions.remaining_s(session, 100.0) == 50.0
    assert not sessions.use(session, 150.0)


def test_an_ended_or_unknown_session_is_none() -> None:
    sessions = Sessions(idle_s=100.0, max_s=150.0)
    session = sessions.begin(0.0)
    sessions.end(session)
    assert not sessions.use(session, 1.0)
    assert not sessions.use("", 1.0)
    assert not sessions.use("ä", 1.0)


def test_the_oldest_session_ends_when_there_are_too_many() -> None:
    sessions = Sessions(idle_s=100.0, max_s=150.0)
    begun = [sessions.begin(0.0) for _ in range(SESSIONS_MAX + 1)]
    assert not sessions.use(begun[0], 1.0)
    assert all(sessions.use(session, 1.0) for session in begun[1:])


def test_an_address_waits_after_five_wrong_passwords_and_others_do_not() -> None:
    limiter = LoginLimiter()
    for t_s in (0.0, 1.0, 2.0, 3.0):
        limiter.on_failure("192.0.2.1", t_s)
    assert limiter.wait_s("192.0.2.1", 4.0) == 0.0
    limiter.on_failure("192.0.2.1", 4.0)
    assert limiter.wait_s("192.0.2.1", 10.0) == 50.0
    assert limiter.wait_s("192.0.2.2", 10.0) == 0.0
    assert limiter.wait_s("192.0.2.1", 60.0) == 0.0


def test_the_addresses_of_one_ipv6_network_are_one() -> None:
    limiter = LoginLimiter()
    for number in range(5):
        limiter.on_failure(f"2001:db8::{number}", 0.0)
    assert limiter.wait_s("2001:db8::ffff", 1.0) > 0.0
    assert limiter.wait_s("2001:db8:0:1::1", 1.0) == 0.0


def test_a_right_password_forgets_the_wrong_ones() -> None:
    limiter = LoginLimiter()
    for _ in range(5):
        limiter.on_failure("192.0.2.1", 0.0)
    limiter.on_success("192.0.2.1")
    assert limiter.wait_s("192.0.2.1", 1.0) == 0.0


def test_the_table_of_addresses_is_bounded_and_the_oldest_ones_leave_it() -> None:
    limiter = LoginLimiter()
    for number in range(5):
        limiter.on_failure("192.0.2.1", float(number))
    for number in range(ADDRESSES_MAX):
        limiter.on_failure(f"10.0.{number // 256}.{number % 256}", 5.0)
    assert limiter.wait_s("192.0.2.1", 6.0) == 0.0
