"""Work on a Ray cluster: :class:`RayEngine`, and what :mod:`prbench.engine.cluster` needs of Ray."""

from __future__ import annotations

import contextlib
import importlib
import inspect
import logging
import os
import signal
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable, Collection, Hashable, Iterable, Iterator
from dataclasses import KW_ONLY, dataclass, field, replace
from pathlib import Path
from types import ModuleType
from typing import Any, cast

from prbench.engine import node_facts as facts_module
from prbench.engine.cluster import Answered, Node, Rules, Spread, Staff, WorkerLostError
from prbench.engine.nodes import Needs, Question, problems, question
from prbench.engine.pool import Full, IfFull, Item, Result, answer
from prbench.errors import ClusterError, MissingExtraError, PrbenchError, StorageError, WorkStopped
from prbench.shown import quoted


class RayWorker:
    """Keeps the function of the last item, and with it what that function has loaded."""

    def __init__(self, folder: str, environment: dict[str, str]) -> None:
        # Not by Ray's runtime environments: for each of those every worker would be started anew.
        os.environ.update(environment)
        if os.path.isdir(folder):  # noqa: PTH112 - relative paths mean there what they mean here
            os.chdir(folder)
        self._packed = b""
        self._function: Callable[[Any], Any] | None = None

    def hello(self) -> int:
        """Answer as soon as the worker is ready, with its process id."""
        return os.getpid()

    def work(self, function: bytes, item: bytes) -> bytes:
        """Work on an item; packed here, so that Ray neither wraps errors nor keeps views of its store."""
        cloudpickle = importlib.import_module("ray.cloudpickle")

        outcome: Answered | Full
        try:
            if self._function is None or self._packed != function:
                self._packed, self._function = function, cloudpickle.loads(function)
            found = answer(cast(Callable, self._function), cloudpickle.loads(item))
            outcome = found if isinstance(found, Full) else Answered(found)
        except Exception as error:
            outcome = Answered(error=error)
        try:
            return cloudpickle.dumps(outcome)
        except Exception as error:
            what = (outcome.error if isinstance(outcome, Answered) else None) or error
            problem = PrbenchError(f"a result cannot leave its process: {type(what).__name__}: {quoted(what)}")
            return cloudpickle.dumps(Answered(error=problem))


_LOOPBACK = {"127.0.0.1", "localhost", "::1"}
# Seconds in which a cluster's head must take a connection; Ray itself tries for minutes.
_ANSWERS_WITHIN_S = 5.0
# Seconds in which a node must answer the question before work: its first process of Python starts for it.
_FACTS_WITHIN_S = 120.0
# Times that a node that joins may not take the question, before it is left out.
_ASKED_IN_VAIN = 3
# Seconds in which a finished result must be here.
_RESULT_WITHIN_S = 120.0


@dataclass(eq=False, repr=False)
class RayEngine:
    """Workers on the nodes of a Ray cluster, or of a Ray that is started on this machine.

    Connects with the first work, after every node was checked; workers are kept until :meth:`close`.

    Args:
        address: Address of the cluster's head (``HOST:PORT``), ``auto`` for the one that this machine belongs to; None
            for ``RAY_ADDRESS``, or without that a Ray of this machine alone.
        workers: Workers at a time; None for one for every ``cpus_per_worker`` processors of the cluster.
        cpus_per_worker: Processors that each one occupies.
        gpus_per_worker: GPUs that each one occupies, such as 0.5; it sees no other ones.
        needs: What must be the same on every node.
        rules: Bounds of the work; ``most_workers`` is replaced by ``workers``.
        tell: Told, in a line, what the user should know: nodes that are gone, items that are tried again.
    """

    address: str | None = None
    _: KW_ONLY
    workers: int | None = None
    cpus_per_worker: int = 1
    gpus_per_worker: float = 0.0
    needs: Needs = field(default_factory=Needs)
    rules: Rules = field(default_factory=Rules)
    tell: Callable[[str], None] = lambda _: None
    _staff: Staff | None = field(default=None, init=False)
    _undo: contextlib.ExitStack = field(default_factory=contextlib.ExitStack, init=False)

    def map(
        self, function: Callable[[Item], Result], items: Iterable[Item], *, if_full: IfFull[Item, Result] = None
    ) -> Iterator[Result]:
        """See :class:`prbench.engine.Engine`.

        Raises:
            ClusterError: if there is no cluster, a node is unfit, or none is left.
            MissingExtraError: if Ray is not installed.
            MemoryFullError: if the memory does not suffice for an item, or workers die with it, also when it is alone.
            WorkStopped: after SIGTERM.
        """
        return Spread(self._connected(), function, items, if_full).results()

    def capacity(self) -> int:
        """Workers that the cluster has room for, at most ``workers``."""
        return max(self._connected().capacity(), 1)

    def close(self) -> None:
        """End the workers, and the Ray that was started for them."""
        self._staff = None
        self._undo.close()

    def _connected(self) -> Staff:
        if self._staff is None:
            try:
                self._staff = self._hired()
            except BaseException:
                self.close()
                raise
        return self._staff

    def _hired(self) -> Staff:
        """Connect, check every node, and make ready for workers."""
        if self.address is not None and _host_and_port(self.address)[0] in _LOOPBACK:
            # Ray replaces a loopback address by the machine's own, at which a head that is bound to loopback does not
            # listen; this setting keeps it, and has to be there before Ray is imported.
            os.environ.setdefault("RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER", "0")
        try:
            for name in ("cloudpickle", "exceptions", "util.scheduling_strategies"):
                importlib.import_module(f"ray.{name}")
            ray = importlib.import_module("ray")
        except ImportError as error:
            raise MissingExtraError("ray", "ray", "--engine ray") from error
        with _sigterm_noted():
            _connect(ray, self.address, self._undo)  # which puts a handler there that leaves at once
        stop = self._undo.enter_context(_sigterm_noted())
        cluster = RayCluster(ray, self.cpus_per_worker, self.gpus_per_worker, self.needs, self.tell, stop)
        cluster.require_fit()
        staff = Staff(cluster, replace(self.rules, most_workers=self.workers), self.tell)
        # Last in, first out: workers end before the Ray that they belong to.
        self._undo.callback(lambda: staff.dismiss(staff.workers))
        return staff


@dataclass(eq=False, repr=False)
class RayCluster:
    """What the rules of spreading need, by Ray: see :class:`prbench.engine.cluster.Cluster`."""

    ray: ModuleType
    cpus: int
    gpus: float
    needs: Needs
    tell: Callable[[str], None]
    told_to_stop: threading.Event

    def __post_init__(self) -> None:
        self._fit: dict[str, bool] = {}
        """Whether a node, by its id, may be given work."""
        self._unasked: Counter[str] = Counter()
        """How often in vain a node was asked for its facts."""
        self._environment = {name: text for name, text in os.environ.items() if name.startswith("PRBENCH_")}
        for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
            self._environment[name] = str(self.cpus)

    def require_fit(self) -> None:
        """Check every node.

        Raises:
            ClusterError: naming every unfit node and what to do, or if none has room for a worker.
        """
        alive = self._alive()
        unfit = self._unfit(alive)
        if unfit:
            lines = [f"node {_name(node)}: {text}" for node in alive for text in unfit.get(node["NodeID"], ())]
            raise ClusterError("\n".join(["the cluster is not fit for this work, so nothing was started.", *lines]))
        if not any(self._slots(node) for node in alive):
            rooms = []
            for node in alive:
                counts = [f"{node['Resources'].get(kind, 0):g}" for kind in ("CPU", "GPU")]
                rooms.append(f"{_name(node)} {counts[0]} processors and {counts[1]} GPUs")
            problem = f"expected a node with {self.cpus} processors and {self.gpus:g} GPUs for a worker"
            remedy = "Ask for less (--threads, --gpus-per-worker), or add a node by `ray start`."
            raise ClusterError(f"{problem}, found {', '.join(rooms) or 'no node'}. {remedy}")

    def nodes(self) -> list[Node]:
        """See :meth:`Cluster.nodes`; a node that joins later is checked, and named and left out where it is unfit."""
        alive = self._alive()
        new = [node for node in alive if node["NodeID"] not in self._fit]
        if new:
            unfit = self._unfit(new)
            for node in (each for each in new if each["NodeID"] in self._fit):
                for text in unfit.get(node["NodeID"], ()):
                    self.tell(f"node {_name(node)} has joined and is left out: {text}")
        return [
            Node(node["NodeID"], _name(node), slots, node["Resources"].get("memory", 0.0))
            for node in alive
            if self._fit.get(node["NodeID"]) and (slots := self._slots(node))
        ]

    def _alive(self) -> list[dict[str, Any]]:
        found = (node for node in self.ray.nodes() if node["Alive"])
        return sorted(found, key=lambda node: (node["NodeManagerAddress"], node["NodeID"]))

    def _slots(self, node: dict[str, Any]) -> int:
        resources = node["Resources"]
        slots = int(resources.get("CPU", 0)) // self.cpus
        if self.gpus:
            slots = min(slots, int(resources.get("GPU", 0) / self.gpus + 1e-6))
        return slots

    def _unfit(self, nodes: list[dict[str, Any]]) -> dict[str, list[str]]:
        """Ask nodes for their facts: what is wrong, by node; nothing of a node that is gone by then."""
        with question(self.needs) as asked:
            tickets = {self._ask(node, asked): node for node in nodes}
            waiting = list(tickets)
            until = time.monotonic() + _FACTS_WITHIN_S
            unfit: dict[str, list[str]] = {}
            in_vain: set[str] = set()
            while waiting:
                due, waiting = self.ray.wait(waiting, num_returns=1, timeout=max(0.0, until - time.monotonic()))
                if not due:
                    break
                name = tickets[due[0]]["NodeID"]
                try:
                    unfit[name] = problems(self.ray.get(due[0]), asked, time.time())
                except self.ray.exceptions.RayError as error:
                    self._unasked[name] += 1
                    in_vain.add(name)
                    unfit[name] = [f"it cannot be asked ({_first_line(error)}). `ray logs` on that node says more."]
            for ticket in waiting:
                said = f"it did not answer within {_FACTS_WITHIN_S:.0f} s. Is it overloaded, or behind a firewall?"
                unfit[tickets[ticket]["NodeID"]] = [said]
                self.ray.cancel(ticket, force=True)
        for node in nodes:
            # A node that has just joined, or is about to go, may not take a question yet: it is asked again.
            if node["NodeID"] not in in_vain or self._unasked[node["NodeID"]] == _ASKED_IN_VAIN:
                self._fit[node["NodeID"]] = not unfit.get(node["NodeID"])
        return {name: texts for name, texts in unfit.items() if texts}

    def _ask(self, node: dict[str, Any], asked: Question) -> Hashable:
        source = inspect.getsource(facts_module)

        def tell_facts(text: str, wanted: dict[str, Any]) -> Any:  # travels as it is: a node may lack prbench
            names: dict[str, Any] = {"__name__": "node_facts"}
            exec(text, names)
            return names["node_facts"](wanted)

        options = {"num_cpus": 0, "max_retries": 0, "scheduling_strategy": self._on(node["NodeID"])}
        return self.ray.remote(tell_facts).options(**options).remote(source, asked.wanted)

    def _on(self, node: str) -> Any:
        return self.ray.util.scheduling_strategies.NodeAffinitySchedulingStrategy(node, soft=False)

    def packed(self, what: object) -> bytes:
        """See :meth:`Cluster.packed`."""
        return self.ray.cloudpickle.dumps(what)

    def start(self, node: Node) -> tuple[Any, Hashable]:
        """See :meth:`Cluster.start`."""
        options: dict[str, Any] = {
            "num_cpus": self.cpus,
            "num_gpus": self.gpus,
            "max_restarts": 0,
            "max_task_retries": 0,
            "scheduling_strategy": self._on(node.id),
        }
        worker = self.ray.remote(RayWorker).options(**options).remote(str(Path.cwd()), self._environment)
        return worker, worker.hello.remote()

    def submit(self, worker: Any, function: bytes, item: bytes) -> Hashable:
        """See :meth:`Cluster.submit`.

        Raises:
            StorageError: if neither Ray's memory nor its disk has room for the item.
        """
        try:
            return worker.work.remote(function, item)
        except self._full as error:
            raise _store_full(error) from error

    def stop(self, worker: Any) -> None:
        """See :meth:`Cluster.stop`."""
        with contextlib.suppress(self.ray.exceptions.RayError, ValueError):
            self.ray.kill(worker, no_restart=True)

    def finished(self, tickets: Collection[Hashable], seconds: float) -> Collection[Hashable]:
        """See :meth:`Cluster.finished`.

        Raises:
            WorkStopped: after SIGTERM, once.
        """
        if self.told_to_stop.is_set():
            self.told_to_stop.clear()  # the workers still have to be ended
            why = "finished parts are kept, the same command goes on where it resumes."
            raise WorkStopped(f"asked to stop by SIGTERM; {why}")
        due, rest = self.ray.wait(list(tickets), num_returns=1, timeout=seconds)
        if due and rest:
            due += self.ray.wait(rest, num_returns=len(rest), timeout=0)[0]
        return due

    def result(self, ticket: Hashable) -> Any:
        """See :meth:`Cluster.result`.

        Raises:
            WorkerLostError: if the worker ended before.
            StorageError: if neither Ray's memory nor its disk has room for the result.
        """
        try:
            found = self.ray.get(ticket, timeout=_RESULT_WITHIN_S)
        except self._full as error:
            raise _store_full(error) from error
        except self.ray.exceptions.RayError as error:
            # Ray's message on any death lists a full memory among common causes, so only the exact words tell.
            name, said = type(error).__name__, str(error)
            memory = name == "OutOfMemoryError" or "running low on memory" in said
            machine = name == "NodeDiedError" or "its node has died" in said
            raise WorkerLostError(_first_line(error), memory=memory, machine=machine) from error
        return self.ray.cloudpickle.loads(found) if isinstance(found, bytes) else found

    @property
    def _full(self) -> tuple[type[Exception], ...]:
        exceptions = self.ray.exceptions
        return exceptions.OutOfDiskError, exceptions.ObjectStoreFullError


def _connect(ray: ModuleType, address: str | None, undo: contextlib.ExitStack) -> None:
    """Connect to the cluster, or start a Ray on this machine; undone by ``undo``.

    Raises:
        ClusterError: if nothing answers at the address, or it is no address.
    """
    if ray.is_initialized():
        return  # the caller's own connection, which is left as it is
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # a Ray that is started here tells nobody
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")  # or each worker warns of a later version of Ray
    settings: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.ERROR}
    wanted = address or os.environ.get("RAY_ADDRESS")
    if wanted is None:
        settings |= {"address": "local", "include_dashboard": False, "_node_ip_address": "127.0.0.1"}
    else:
        _require_listening(wanted)
        settings["address"] = wanted
    try:
        ray.init(**settings)
    except Exception as error:  # Ray raises ConnectionError, RuntimeError, ValueError and its own
        where = f"at {quoted(wanted)}" if wanted else "on this machine"
        why = f"no Ray could be used {where} ({type(error).__name__}: {_first_line(error)})."
        remedy = "Start one by `ray start --head`, or leave --address out for this machine alone."
        raise ClusterError(f"--engine ray: {why} {remedy}") from error
    undo.callback(ray.shutdown)
    # Of dead workers and nodes Ray prints pages of its logs to standard output, which belongs to reports; what a user
    # needs of it is told by the rules of spreading. There is no setting for this; where a later version names its
    # function otherwise, it is heard again.
    worker = ray._private.worker
    spoken = getattr(worker, "print_to_stdstream", None)
    if spoken is not None:
        worker.print_to_stdstream = lambda *_, **__: None
        undo.callback(setattr, worker, "print_to_stdstream", spoken)


def _require_listening(address: str) -> None:
    """Refuse at once an address at which nothing listens.

    Raises:
        ClusterError: naming it.
    """
    if address in ("auto", "local"):
        return
    if "://" in address:
        problem = "Ray's client (ray://) reads files of its own machine"
        remedy = "run the command on a node of the cluster, for example by `ray job submit`."
        raise ClusterError(f"--address {quoted(address)}: expected HOST:PORT of the head, or auto. {problem}: {remedy}")
    host, port = _host_and_port(address)
    if port is None:
        raise ClusterError(f"--address {quoted(address)}: expected HOST:PORT, such as 10.0.0.1:6379, or auto.")
    try:
        socket.create_connection((host, port), timeout=_ANSWERS_WITHIN_S).close()
    except OSError as error:
        why = f"({error.strerror or error}). `ray start --head` on that machine starts one and prints its address."
        raise ClusterError(f"--address {quoted(address)}: no Ray answers there {why}") from error


def _host_and_port(address: str) -> tuple[str, int | None]:
    host, _, port = address.rpartition(":")
    return host.strip("[]") or address, int(port) if port.isdecimal() and int(port) < 65536 else None


@contextlib.contextmanager
def _sigterm_noted() -> Iterator[threading.Event]:
    """Note SIGTERM, so that workers are ended before the process; a second one is obeyed at once.

    It is not turned into an exception where it arrives: Ray's own functions do not stand that.
    """
    stop = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield stop
        return
    before = signal.getsignal(signal.SIGTERM)

    def note(*_: object) -> None:
        stop.set()
        signal.signal(signal.SIGTERM, signal.SIG_DFL)

    signal.signal(signal.SIGTERM, note)
    try:
        yield stop
    finally:
        signal.signal(signal.SIGTERM, before)


def _name(node: dict[str, Any]) -> str:
    return quoted(f"{node['NodeManagerAddress']} ({node['NodeManagerHostname']})", longest=80)


def _first_line(error: Exception) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return quoted(lines[0].rstrip(".") if lines else type(error).__name__)


def _store_full(error: Exception) -> StorageError:
    remedy = "Free some disk below its folder (/tmp/ray), let less wait by a smaller --spill-limit"
    problem = f"Ray has no room left for items and results ({_first_line(error)})"
    return StorageError(f"{problem}. {remedy}, and run the same command again.")
