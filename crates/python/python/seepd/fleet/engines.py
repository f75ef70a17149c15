"""Who does the work: this process, processes of this machine, or Ray. A worker that dies costs a retry, and after three of them its unit
comes back as lost."""

from __future__ import annotations

import multiprocessing
import multiprocessing.connection
from collections.abc import Callable, Iterator
from typing import Any, Protocol

from ..errors import InternalError, TemporaryError
from ..table import need
from .sources import one_line

Unit = dict[str, Any]
Work = Callable[[Unit], dict[str, Any]]

#: Workers that a unit may cost.
ATTEMPTS = 3


class Engine(Protocol):
    """Does units in any order, and holds no more of them than it needs to keep its workers busy."""

    def run(self, units: Iterator[Unit], work: Work) -> Iterator[tuple[Unit, dict[str, Any]]]:
        """Each unit with what came of it; ``{"lost": n}`` where n workers died of it."""
        ...

    def close(self) -> None:
        """Lets the workers go."""
        ...


class Serial:
    """One unit after the other, in this process."""

    def run(self, units: Iterator[Unit], work: Work) -> Iterator[tuple[Unit, dict[str, Any]]]:
        for unit in units:
            yield unit, work(unit)

    def close(self) -> None:
        """Nothing to let go."""


#: A worker's first word.
_READY = {"status": "ready"}
#: Workers in a row that may die before it.
STILLBORN = 20


def _serve(pipe: Any, work: Work) -> None:
    """A worker's life: a unit in, what came of it out."""
    import signal

    # The one who hands out the work hears of Ctrl-C, and ends the workers.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    pipe.send(_READY)
    while True:
        try:
            unit = pipe.recv()
        except (EOFError, OSError):
            return  # Let go, perhaps before its first word was heard, which the system calls a reset.
        pipe.send(work(unit))


class Pool:
    """Processes of this machine, a unit each at a time: whose unit a dead worker had is always known, which a pool of the standard
    library does not tell."""

    def __init__(self, workers: int) -> None:
        self._context = multiprocessing.get_context("spawn")
        self._workers: dict[Any, Any] = {}
        self._count = workers

    def run(self, units: Iterator[Unit], work: Work) -> Iterator[tuple[Unit, dict[str, Any]]]:
        again: list[tuple[Unit, int]] = []
        busy: dict[Any, tuple[Unit, int]] = {}
        idle: list[Any] = []
        starting = {self._start(work) for _ in range(self._count)}
        stillborn, is_more = 0, True
        while True:
            while idle and (again or is_more):
                if again:
                    unit, attempt = again.pop()
                elif (unit := next(units, None)) is None:  # type: ignore[arg-type]
                    is_more = False
                    continue
                else:
                    attempt = 1
                pipe = idle.pop()
                busy[pipe] = (unit, attempt)
                try:
                    pipe.send(unit)
                except OSError:
                    pass  # It has died while idle; its pipe says so below.
            if not busy and not again and not is_more:
                break
            readable: list[Any] = list(multiprocessing.connection.wait([*busy, *starting]))
            for pipe in readable:
                if pipe in starting:
                    starting.remove(pipe)
                    try:
                        pipe.recv()
                    except (EOFError, OSError):
                        stillborn += 1
                        if stillborn > STILLBORN:
                            raise InternalError(
                                "no worker begins: does the script that starts them guard its main part?"
                            ) from None
                        self._bury(pipe)
                        starting.add(self._start(work))
                    else:
                        stillborn = 0
                        idle.append(pipe)
                    continue
                unit, attempt = busy.pop(pipe)
                try:
                    result = pipe.recv()
                except (EOFError, OSError):
                    self._bury(pipe)
                    starting.add(self._start(work))
                    if attempt < ATTEMPTS:
                        again.append((unit, attempt + 1))
                    else:
                        yield unit, {"lost": attempt}
                    continue
                idle.append(pipe)
                yield unit, result
        for pipe in [*idle, *starting]:
            self._bury(pipe)

    def _start(self, work: Work) -> Any:
        ours, theirs = self._context.Pipe()
        worker = self._context.Process(target=_serve, args=(theirs, work), daemon=True)
        worker.start()
        theirs.close()
        self._workers[ours] = worker
        return ours

    def _bury(self, pipe: Any) -> None:
        """A worker that hears no more goes; one that does not, made to."""
        pipe.close()
        worker = self._workers.pop(pipe)
        worker.join(timeout=5)
        if worker.is_alive():
            worker.terminate()

    def close(self) -> None:
        for pipe, worker in list(self._workers.items()):
            worker.terminate()
            worker.join(timeout=10)
            pipe.close()
        self._workers.clear()


class Ray:
    """A cluster by its address, or a Ray of this machine's own."""

    def __init__(self, address: str | None = None, workers: int | None = None) -> None:
        import logging
        import os

        os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
        self._ray = need("ray", "fleet")
        options: dict[str, Any] = {"include_dashboard": False, "log_to_driver": False, "logging_level": logging.ERROR}
        if address is not None:
            _reachable(address)
            options["address"] = address
            del options["include_dashboard"]
        else:
            # Not a cluster that the surroundings happen to name.
            options |= {"address": "local", "num_cpus": workers}
        try:
            self._ray.init(**options)
        except Exception as error:  # Ray has a dozen kinds for it.
            raise TemporaryError(
                f"{address or 'a local Ray'}: no Ray could be reached: {one_line(error)[:200]}"
            ) from None

    @property
    def slots(self) -> int:
        """Units that can be under way."""
        return int(self._ray.cluster_resources().get("CPU", 1))

    def run(self, units: Iterator[Unit], work: Work) -> Iterator[tuple[Unit, dict[str, Any]]]:
        ray = self._ray
        remote = ray.remote(num_cpus=1, max_retries=ATTEMPTS - 1, retry_exceptions=False)(work)
        under_way: dict[Any, Unit] = {}
        # Enough that no worker waits for the driver, and few enough that the driver's memory knows nothing of the manifest's length.
        most = 4 * max(1, self.slots)
        is_more = True
        while is_more or under_way:
            while is_more and len(under_way) < most:
                unit = next(units, None)
                if unit is None:
                    is_more = False
                else:
                    under_way[remote.remote(unit)] = unit
            if not under_way:
                return
            done, others = ray.wait(list(under_way), num_returns=1)
            # What else is done comes with it: a wait looks at every task that is under way.
            done += ray.wait(others, num_returns=len(others), timeout=0)[0] if others else []
            for task in done:
                unit = under_way.pop(task)
                try:
                    yield unit, ray.get(task)
                except (
                    ray.exceptions.WorkerCrashedError,
                    ray.exceptions.NodeDiedError,
                    ray.exceptions.OutOfMemoryError,
                ):
                    yield unit, {"lost": ATTEMPTS}
                except ray.exceptions.RayTaskError as error:
                    yield unit, {"refused": one_line(error.cause or error), "exit_code": 70}

    def close(self) -> None:
        self._ray.shutdown()


def _reachable(address: str) -> None:
    """Ray waits for minutes for a cluster that is not there; a port that nobody listens on is known at once."""
    import socket

    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not host or not port.isdigit():
        return
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=5).close()
    except OSError as error:
        raise TemporaryError(f"{address}: no Ray cluster is there: {error.strerror or error}") from None
