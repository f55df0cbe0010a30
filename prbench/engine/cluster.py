"""Spread items over the workers of several machines: results in order, whoever dies.

The rules are here, and nothing of Ray. What they need of a cluster stands in :class:`prbench.engine.on_ray.RayCluster`:
``nodes()``, ``packed(what)``, ``start(node)`` and ``submit(worker, function, item)``, which return tickets of what will
have happened, ``stop(worker)``, ``finished(tickets, seconds)`` and ``result(ticket)``.

- Every worker has one item at a time. A worker that dies is replaced, and its item goes on elsewhere.
- An item for which the memory did not suffice, or with which several workers died, is tried once more, alone.
- Items and results that wait are bounded in number and in bytes, so memory stays flat and little is spilled to disk.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Hashable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from prbench.engine.pool import KILLED, Full, item_name, settled
from prbench.errors import ClusterError

# Seconds of one look at what has finished.
_POLL_S = 0.5
# Seconds between two looks at which machines there are.
_NODES_EVERY_S = 2.0
# Items that are taken up and not yet handed on, a worker: so far a slow item may lag behind the others.
_WINDOW = 4


@dataclass(frozen=True)
class Node:
    """A machine of the cluster that may be given work.

    Attributes:
        name: Address and host name, for messages.
        slots: Workers that its processors and accelerators suffice for.
        memory: Bytes of memory.
    """

    id: str
    name: str
    slots: int
    memory: float


@dataclass(frozen=True)
class Answered:
    """The result of an item, or the exception that it raised."""

    value: Any = None
    error: Exception | None = None


class WorkerLostError(Exception):
    """A worker ended without an answer.

    Args:
        reason: What is known of it.
        memory: It was ended because its machine's memory was full.
        machine: Its whole machine is gone.
    """

    def __init__(self, reason: str, *, memory: bool = False, machine: bool = False) -> None:
        super().__init__(reason)
        self.reason, self.memory, self.machine = reason, memory, machine


@dataclass(frozen=True)
class Rules:
    """The bounds within which items are handed out.

    Attributes:
        most_workers: Workers at a time; None for as many as the cluster has processors for.
        most_waiting_bytes: Bytes of packed items that may be under way at a time; one item is always allowed.
        tries: Workers that may die with an item before it is tried alone.
        strikes: Failed starts after which a machine is left out.
        patience: Seconds to wait for a machine where there is none.
    """

    most_workers: int | None = None
    most_waiting_bytes: float = 4e9
    tries: int = 3
    strikes: int = 3
    patience: float = 60.0


@dataclass(eq=False)
class _Work:
    """An item that is under way.

    Attributes:
        suspected: The memory did not suffice, or workers died with it; it is tried alone.
    """

    item: Any
    packed: bytes
    deaths: int = 0
    suspected: bool = False
    alone: bool = False
    outcome: Answered | Full | None = None


@dataclass(eq=False)
class _Worker:
    """A worker, and what it does.

    Attributes:
        ticket: Ticket of the worker's start, then of its item; None while it has nothing to do.
    """

    handle: Any
    node: Node
    ticket: Hashable | None
    ready: bool = False
    work: _Work | None = None


@dataclass(eq=False, repr=False)
class Staff:
    """The workers of a cluster, which are kept from one piece of work to the next.

    Args:
        cluster: The cluster that they work on.
        rules: Within what bounds.
        tell: Told, in a line, what the user should know.
        clock: Seconds that only grow.
    """

    cluster: Any
    rules: Rules
    tell: Callable[[str], None]
    clock: Callable[[], float] = time.monotonic

    def __post_init__(self) -> None:
        self.workers: list[_Worker] = []
        self._nodes: dict[str, Node] = {}
        self._looked = -_NODES_EVERY_S
        self._last_seen = self.clock()
        self._strikes: dict[str, int] = {}
        self._ending: set[Hashable] = set()
        self._why = ""

    def nodes(self) -> dict[str, Node]:
        """Return the machines that are not left out by their ids, looked up now and then."""
        now = self.clock()
        if now - self._looked >= _NODES_EVERY_S:
            self._looked = now
            found = {node.id: node for node in self.cluster.nodes()}
            for lost in self._nodes.keys() - found.keys():
                self.tell(f"node {self._nodes[lost].name} is gone; its items go on elsewhere.")
            self._nodes = found
        left = {name: each for name, each in self._nodes.items() if self._strikes.get(name, 0) < self.rules.strikes}
        if left:
            self._last_seen = now
        return left

    def places(self) -> dict[str, int]:
        """How many workers each machine is to have: all that it has room for, or its share of ``most_workers``."""
        nodes = self.nodes()
        slots = {name: node.slots for name, node in nodes.items()}
        if self.rules.most_workers is None:
            return slots
        share = dict.fromkeys(nodes, 0)
        while sum(share.values()) < min(self.rules.most_workers, sum(slots.values())):
            free = [name for name in nodes if share[name] < slots[name]]
            share[min(free, key=lambda name: share[name])] += 1
        return share

    def capacity(self) -> int:
        """Workers that there can be."""
        return sum(self.places().values())

    def idle(self) -> list[_Worker]:
        """Workers with nothing to do, on machines that are not left out."""
        left = self.nodes()
        return [worker for worker in self.workers if worker.ready and worker.work is None and worker.node.id in left]

    def busy(self) -> list[_Worker]:
        """Workers with an item."""
        return [worker for worker in self.workers if worker.work is not None]

    def hire(self, wanted: int) -> None:
        """Start workers until so many are starting, as far as the machines have room."""
        free = self.places()
        for worker in self.workers:
            if worker.node.id in free:
                free[worker.node.id] -= 1
        for _ in range(wanted - sum(not worker.ready for worker in self.workers)):
            roomy = max(free, key=lambda name: free[name], default=None)
            if roomy is None or free[roomy] < 1:
                return
            free[roomy] -= 1
            self._start(self.nodes()[roomy])

    def hire_for_one(self) -> None:
        """Start one worker where the memory is largest, unless there is one."""
        nodes = self.nodes()
        if not self.workers and nodes:
            self._start(max(nodes.values(), key=lambda node: node.memory))

    def _start(self, node: Node) -> None:
        handle, ticket = self.cluster.start(node)
        self.workers.append(_Worker(handle, node, ticket))

    def give(self, worker: _Worker, work: _Work, function: bytes) -> None:
        """Let an idle worker work on an item."""
        worker.work = work
        worker.ticket = self.cluster.submit(worker.handle, function, work.packed)

    def dismiss(self, workers: Iterable[_Worker]) -> None:
        """End workers at once."""
        for worker in list(workers):
            self.workers.remove(worker)
            if worker.ticket is not None:
                self._ending.add(worker.ticket)
            self.cluster.stop(worker.handle)

    def await_dismissed(self, seconds: float) -> None:
        """Wait until dismissed workers have ended: nothing may be written once the work is said to be done."""
        until = self.clock() + seconds
        while self._ending and self.clock() < until:
            self._ending -= set(self.cluster.finished(self._ending, min(seconds, _POLL_S)))
        self._ending.clear()

    def strike(self, node: Node, why: str) -> None:
        """Note that no worker started on a machine, and leave it out when that happened too often."""
        strikes = self._strikes[node.id] = self._strikes.get(node.id, 0) + 1
        self._why = f"node {node.name}: {why}"
        if strikes == self.rules.strikes:
            self.tell(f"node {node.name} is left out from here on: {why}.")
            self.dismiss(worker for worker in self.workers if worker.node.id == node.id and worker.work is None)

    def finished(self, seconds: float) -> list[tuple[_Worker, Answered | Full | WorkerLostError | None]]:
        """Workers that have become ready (None), have answered, or are lost; lost ones are taken off the list.

        Raises:
            ClusterError: if there has been no machine to work on for too long.
        """
        waiting = {worker.ticket: worker for worker in self.workers if worker.ticket is not None}
        if not waiting:
            if not self.nodes() and self.clock() - self._last_seen > self.rules.patience:
                reason = f" The last one left out: {self._why}." if self._why else ""
                problem = f"waited {self.rules.patience:.0f} s for one.{reason} What is finished is kept"
                remedy = "see to the cluster (`ray status`) and run the same command again."
                raise ClusterError(f"no node of the cluster is left to work on; {problem}: {remedy}")
            time.sleep(min(seconds, 0.1))
            return []
        found = []
        for ticket in self.cluster.finished(waiting.keys(), seconds):
            worker = waiting[ticket]
            worker.ticket = None
            try:
                result = self.cluster.result(ticket)
            except WorkerLostError as lost:
                self.workers.remove(worker)
                self.cluster.stop(worker.handle)
                self._looked = -_NODES_EVERY_S
                found.append((worker, lost))
                continue
            found.append((worker, result if worker.ready else None))
            worker.ready = True
        return found


class Spread:
    """One function over many items on a staff of workers: what :meth:`prbench.engine.Engine.map` promises.

    Args:
        staff: The workers.
        function: What is done with an item.
        items: Taken up as they are needed.
        if_full: See :meth:`prbench.engine.Engine.map`.
    """

    def __init__(self, staff: Staff, function: Callable, items: Iterable, if_full: Callable | None) -> None:
        self._staff = staff
        self._function = staff.cluster.packed(function)
        self._items = iter(items)
        self._if_full = if_full
        self._line: deque[_Work] = deque()
        """Taken up and not yet handed on, in order."""
        self._to_do: deque[_Work] = deque()
        """Those of them that nobody works on."""
        self._all_taken = False

    def results(self) -> Iterator[Any]:
        """Yield the results in order; whatever is still at work when this ends is ended."""
        try:
            while True:
                self._take_up()
                if not self._line:
                    return
                self._hand_out()
                head = self._line[0]
                self._gather(0.0 if head.outcome is not None else _POLL_S)
                if head.outcome is None:
                    continue
                self._hand_out()  # before the caller is busy with the result
                self._line.popleft()
                found = head.outcome
                if isinstance(found, Answered) and found.error is not None:
                    raise found.error
                found = found.value if isinstance(found, Answered) else found
                yield settled(found, head.item, self._if_full)
        finally:
            self._staff.dismiss(self._staff.busy())
            self._staff.await_dismissed(10.0)

    def _take_up(self) -> None:
        most = _WINDOW * max(self._staff.capacity(), 1)
        size = sum(len(work.packed) for work in self._line)
        while not self._all_taken and len(self._line) < most:
            if self._line and size >= self._staff.rules.most_waiting_bytes:
                return
            try:
                item = next(self._items)
            except StopIteration:
                self._all_taken = True
                return
            work = _Work(item, self._staff.cluster.packed(item))
            size += len(work.packed)
            self._line.append(work)
            self._to_do.append(work)

    def _hand_out(self) -> None:
        staff = self._staff
        head = self._line[0]
        idle = staff.idle()
        if not head.suspected or head.outcome is not None:
            while idle and self._to_do:
                staff.give(idle.pop(), self._to_do.popleft(), self._function)
            if self._to_do:
                staff.hire(len(self._to_do))
            return
        # Let the others come to their end, free the memory of all workers, and start one for this item.
        if staff.busy():
            return
        if not head.alone:
            head.alone = True
            staff.dismiss(staff.workers)
            idle = []
        if idle:
            staff.give(idle[0], head, self._function)
        else:
            staff.hire_for_one()

    def _gather(self, seconds: float) -> None:
        for worker, found in self._staff.finished(seconds):
            work = worker.work
            worker.work = None
            if work is None:
                if isinstance(found, WorkerLostError) and not found.machine:
                    self._staff.strike(worker.node, f"a worker could not be started there ({found.reason})")
            elif isinstance(found, WorkerLostError):
                self._lost(work, worker, found)
            elif isinstance(found, Full) and not work.alone:
                work.suspected = True
            else:
                work.outcome = found

    def _lost(self, work: _Work, worker: _Worker, lost: WorkerLostError) -> None:
        work.deaths += 1
        if work.alone:
            if not lost.machine or work.deaths > 2 * self._staff.rules.tries:
                work.outcome = Full(f"{KILLED} (node {worker.node.name}: {lost.reason})")
            return
        if lost.memory or work.deaths >= self._staff.rules.tries:
            work.suspected = True
        else:
            self._to_do.appendleft(work)
        why = f"{item_name(work.item)} is tried again{' alone' if work.suspected else ''}."
        self._staff.tell(f"a worker on node {worker.node.name} ended without an answer ({lost.reason}); {why}")
