"""Items reach their result in order, whoever dies: the rules of a cluster, on one that is made of plain objects."""

from __future__ import annotations

import itertools
import pickle
from collections.abc import Callable
from dataclasses import dataclass, field

import pytest

from prbench.engine.cluster import Answered, Node, Rules, Spread, Staff, WorkerLostError
from prbench.engine.pool import Full, answer
from prbench.errors import ClusterError, InputFileError, MemoryFullError

RULES = Rules()


@dataclass
class FakeCluster:
    """Machines whose items take as many ticks of a clock as they are told; nothing runs beside anything."""

    machines: list[Node]
    seconds: Callable[[str, object], float] = lambda machine, item: 1.0
    """How long an item takes on a machine."""
    dies: Callable[[str, object, int], WorkerLostError | None] = lambda machine, item, attempt: None
    """Whether the worker dies with an item, at the so-manieth attempt at it."""
    broken: set[str] = field(default_factory=set)
    """Machines on which no worker starts."""
    now: float = 0.0
    due: dict[int, tuple[float, object]] = field(default_factory=dict)
    worked: list[tuple[str, object]] = field(default_factory=list)
    stopped: list[str] = field(default_factory=list)
    most_at_once: int = 0
    tickets: itertools.count = field(default_factory=itertools.count)
    busy: dict[object, int] = field(default_factory=dict)
    alive: set[tuple[str, int]] = field(default_factory=set)

    def nodes(self):
        return self.machines

    def packed(self, what):
        return pickle.dumps(what)

    def start(self, node):
        number = next(self.tickets)
        worker = (node.id, number)
        lost = WorkerLostError("no Python there") if node.id in self.broken else None
        self.due[number] = (self.now + 0.1, lost)
        self.alive.add(worker)
        return worker, number

    def submit(self, worker, function, packed):
        machine, item = worker[0], pickle.loads(packed)
        attempt = sum(each == item for _, each in self.worked)
        self.worked.append((machine, item))
        number = next(self.tickets)
        self.busy[worker] = number
        self.most_at_once = max(self.most_at_once, len(self.busy))
        lost = self.dies(machine, item, attempt)
        if lost is not None:
            outcome = lost
        else:
            try:
                found = answer(pickle.loads(function), item)
                outcome = found if isinstance(found, Full) else Answered(found)
            except Exception as error:
                outcome = Answered(error=error)
        self.due[number] = (self.now + self.seconds(machine, item), outcome)
        return number

    def stop(self, worker):
        self.stopped.append(worker[0])
        self.alive.discard(worker)
        number = self.busy.pop(worker, None)
        if number in self.due:
            self.due[number] = (self.now, WorkerLostError("stopped"))

    def finished(self, tickets, seconds):
        asked = {ticket: self.due[ticket][0] for ticket in tickets}
        if seconds and asked:
            self.now += min(seconds, max(0.0, min(asked.values()) - self.now)) or 1e-3
        return [ticket for ticket, moment in asked.items() if moment <= self.now]

    def result(self, ticket):
        outcome = self.due.pop(ticket)[1]
        self.busy = {worker: number for worker, number in self.busy.items() if number != ticket}
        if isinstance(outcome, WorkerLostError):
            raise outcome
        return outcome


def machines(*slots: int) -> list[Node]:
    return [Node(chr(97 + i), f"10.0.0.{i + 1}", count, memory=float(i)) for i, count in enumerate(slots)]


def spread(cluster, function, items, *, rules=RULES, if_full=None):
    told: list[str] = []
    staff = Staff(cluster, rules, told.append, clock=lambda: cluster.now)
    return Spread(staff, function, items, if_full).results(), told


def double(value):
    return 2 * value


def refuse_three(value):
    if value == 3:
        raise InputFileError("x.csv", "row 3", expected="a number", found="three")
    return value


def test_results_come_in_the_order_of_the_items_however_long_each_takes():
    cluster = FakeCluster(machines(2, 1), seconds=lambda machine, item: (7 * item) % 5 + 0.1)
    found, told = spread(cluster, double, range(20))
    assert list(found) == [2 * i for i in range(20)]
    assert told == []
    assert {machine for machine, _ in cluster.worked} == {"a", "b"}


def test_no_more_workers_are_started_than_were_asked_for_and_machines_share_them():
    cluster = FakeCluster(machines(8, 8))
    found, _ = spread(cluster, double, range(30), rules=Rules(most_workers=3))
    assert list(found) == [2 * i for i in range(30)]
    assert cluster.most_at_once == 3
    assert len(cluster.alive) == 3
    assert {machine for machine, _ in cluster.alive} == {"a", "b"}


def test_an_error_is_raised_where_its_result_would_stand_and_nobody_works_on():
    cluster = FakeCluster(machines(2))
    found, _ = spread(cluster, refuse_three, range(9))
    assert [next(found) for _ in range(3)] == [0, 1, 2]
    with pytest.raises(InputFileError, match="row 3"):
        next(found)
    assert cluster.busy == {}


def test_items_are_taken_up_as_they_are_needed():
    taken = []
    cluster = FakeCluster(machines(2))
    found, _ = spread(cluster, double, (taken.append(i) or i for i in range(100)))
    next(found)
    assert len(taken) <= 9


def test_only_so_many_bytes_wait_at_a_time():
    taken = []
    items = (taken.append(i) or bytes(1000) for i in range(20))
    found, _ = spread(FakeCluster(machines(4)), len, items, rules=Rules(most_waiting_bytes=2500))
    next(found)
    assert len(taken) <= 4
    assert list(found) == [1000] * 19


def test_an_item_goes_on_with_another_worker_when_its_worker_dies():
    killed = WorkerLostError("killed")
    cluster = FakeCluster(machines(1, 1), dies=lambda machine, item, attempt: killed if attempt < item % 3 else None)
    found, told = spread(cluster, double, range(9))
    assert list(found) == [2 * i for i in range(9)]
    assert len(told) == 9  # once for 1, 4 and 7, twice for 2, 5 and 8
    assert "a worker on node 10.0.0." in told[0]
    assert "one item of the work is tried again." in told[0]


def test_a_machine_that_is_gone_is_told_of_and_its_items_are_done_by_the_others():
    cluster = FakeCluster(machines(1, 1))

    def dies(machine, item, attempt):
        if machine == "b" and item > 2:
            cluster.machines = cluster.machines[:1]
            return WorkerLostError("its node has died", machine=True)
        return None

    cluster.dies = dies
    found, told = spread(cluster, double, range(12))
    assert list(found) == [2 * i for i in range(12)]
    assert "node 10.0.0.2 is gone; its items go on elsewhere." in told


def test_a_machine_that_joins_is_given_work():
    cluster = FakeCluster(machines(1))
    found, _ = spread(cluster, double, range(40))
    next(found)
    cluster.machines = machines(1, 1)
    assert list(found) == [2 * i for i in range(1, 40)]
    assert {machine for machine, _ in cluster.worked} == {"a", "b"}


def test_an_item_with_which_workers_keep_dying_is_tried_alone_and_then_refused():
    alone = []

    def dies(machine, item, attempt):
        if item == 2:
            alone.append((machine, len(cluster.busy)))
            return WorkerLostError("killed")
        return None

    cluster = FakeCluster(machines(1, 1, 1), dies=dies)
    found, told = spread(cluster, double, range(6), if_full=lambda item, error: f"{item}: {error}")
    results = list(found)
    assert [results[i] for i in (0, 1, 3, 4, 5)] == [0, 2, 6, 8, 10]
    assert results[2].startswith("2: one item of the work: a worker process ended without an answer")
    assert len(alone) == RULES.tries + 1
    assert alone[-1] == ("c", 1)  # by itself, where the memory is largest
    assert told[-1].endswith("is tried again alone.")


def test_an_item_that_fits_alone_only_is_done_alone_and_the_others_go_on():
    full = WorkerLostError("killed", memory=True)
    cluster = FakeCluster(machines(1, 1), dies=lambda machine, item, attempt: None if attempt or item != 3 else full)
    found, _ = spread(cluster, double, range(9))
    assert list(found) == [2 * i for i in range(9)]
    assert sum(item == 3 for _, item in cluster.worked) == 2


def too_large(value):
    if value == 1:
        raise MemoryError("too large")
    return value


def test_an_item_for_which_no_memory_suffices_is_named():
    found, _ = spread(FakeCluster(machines(2)), too_large, range(3))
    assert next(found) == 0
    with pytest.raises(MemoryFullError, match="the memory of this machine does not suffice"):
        next(found)


def test_a_machine_where_no_worker_starts_is_left_out():
    cluster = FakeCluster(machines(1, 1), broken={"b"})
    found, told = spread(cluster, double, range(9))
    assert list(found) == [2 * i for i in range(9)]
    assert told == ["node 10.0.0.2 is left out from here on: a worker could not be started there (no Python there)."]


def test_without_any_machine_the_work_ends_with_what_to_do():
    cluster = FakeCluster(machines(1), broken={"a"})
    cluster.finished = lambda tickets, seconds: list(tickets)
    staff = Staff(cluster, Rules(patience=0.0), lambda _: None)
    with pytest.raises(ClusterError, match=r"no node .* 10\.0\.0\.1: a worker could not be started .*`ray status`"):
        list(Spread(staff, double, range(3), None).results())


def test_workers_are_kept_from_one_piece_of_work_to_the_next():
    cluster = FakeCluster(machines(2))
    staff = Staff(cluster, RULES, lambda _: None, clock=lambda: cluster.now)
    list(Spread(staff, double, range(9), None).results())
    before = set(cluster.alive)
    list(Spread(staff, double, range(9), None).results())
    assert cluster.alive == before


def test_whoever_stops_listening_ends_what_is_at_work():
    cluster = FakeCluster(machines(2))
    found, _ = spread(cluster, double, range(9))
    next(found)
    found.close()
    assert cluster.busy == {}
