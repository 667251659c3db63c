"""What a SuperLink says about its runs, at a few milliseconds a question.

The `flwr` command costs more than a second of CPU each time, so these are the same two requests of
Flower's Control API without it. They are internal to Flower: the caller falls back on the command.
Nothing of the environment counts for them, proxies and certificates least of all.
"""

from __future__ import annotations

import http.client
import ssl
from contextlib import closing
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from experiments.flower.environment import HOST

_PROTOBUF = "application/protobuf"
_STREAM = "application/flower-protobuf-stream"
_FRAME_HEADER = 4


class RunState(StrEnum):
    """Where a run is; the last three are its ends."""

    PENDING = "pending"
    STARTING = "starting"
    RUNNING = "running"
    COMPLETED = "completed"
    FAILED = "failed"
    STOPPED = "stopped"


@dataclass(frozen=True)
class Status:
    """State of a run, and why it failed."""

    state: RunState
    details: str = ""

    @property
    def finished(self) -> bool:
        """Whether the run has ended, well or not."""
        return self.state in (RunState.COMPLETED, RunState.FAILED, RunState.STOPPED)


class ControlError(Exception):
    """The SuperLink gave no usable answer."""


def parse_status(status: str, details: str) -> Status:
    """The status that Flower writes as `running` or `finished:failed`."""
    try:
        return Status(RunState(status.removeprefix("finished:")), details)
    except ValueError as error:
        raise ControlError(f"unknown status {status!r}") from error


def is_healthy(port: int, authority: Path | None = None) -> bool:
    """Whether a SuperLink serves that loopback port.

    Args:
        port: the SuperLink's.
        authority: the certificate by which it is known, where it speaks TLS.
    """
    try:
        with closing(_connection(port, authority, timeout_s=2)) as connection:
            connection.request("GET", "/health")
            return connection.getresponse().status == http.client.OK
    except (OSError, http.client.HTTPException):
        return False


def run_status(port: int, run_id: int, authority: Path | None = None) -> Status:
    """State of a run; arguments as in `is_healthy`.

    Raises:
        ControlError: no answer, or not one we understand.
    """
    try:
        from flwr.proto.control_pb2 import ListRunsRequest, ListRunsResponse

        request = ListRunsRequest(run_id=run_id).SerializeToString()
        body = _post(port, authority, "list-runs", request, _PROTOBUF)
        run = ListRunsResponse.FromString(body).run_dict[run_id].status
    except Exception as error:  # an internal interface may fail in any way
        raise ControlError(str(error)) from error
    return parse_status(run.sub_status or run.status, run.details)


def run_log(port: int, run_id: int, authority: Path | None = None) -> str:
    """What the ServerApp and, in a simulation, the clients have printed so far, if anything.

    Raises:
        ControlError: no answer, or not one we understand.
    """
    try:
        from flwr.proto.control_pb2 import StreamLogsRequest, StreamLogsResponse

        request = StreamLogsRequest(run_id=run_id).SerializeToString()
        body = _post(port, authority, "stream-logs", request, _STREAM)
        return StreamLogsResponse.FromString(body).log_output if body else ""
    except TimeoutError:
        return ""
    except Exception as error:  # as above
        raise ControlError(str(error)) from error


def _connection(port: int, authority: Path | None, timeout_s: float) -> http.client.HTTPConnection:
    if authority is None:
        return http.client.HTTPConnection(HOST, port, timeout=timeout_s)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)  # the default one reads the environment
    context.load_verify_locations(cafile=str(authority))
    return http.client.HTTPSConnection(HOST, port, timeout=timeout_s, context=context)


def _post(port: int, authority: Path | None, call: str, request: bytes, accept: str) -> bytes:
    """Send a request; the answer's body, of a stream its first frame."""
    headers = {"content-type": _PROTOBUF, "accept": accept, "accept-encoding": "identity"}
    with closing(_connection(port, authority, timeout_s=5)) as connection:
        connection.request("POST", f"/v1/control/{call}", request, headers)
        response = connection.getresponse()
        if response.status != http.client.OK:
            raise ControlError(f"{call}: HTTP {response.status}")
        if accept == _PROTOBUF:
            return response.read()
        return response.read(int.from_bytes(response.read(_FRAME_HEADER), "big"))
