"""A client's place in a round."""

from dataclasses import dataclass

from lockstep.frame_stream import FrameStream
from lockstep.messages import Layout
from lockstep.wire_format import TEXT_SIZE, actions_size, upload_size


@dataclass(slots=True)
class BlockStats:
    """What one client has cost so far, over all rounds.

    Attributes:
        waited_s: for this client's answers.
        gathered_s: for those of all clients.
    """

    bytes_sent: int = 0
    bytes_received: int = 0
    frames_sent: int = 0
    frames_received: int = 0
    waited_s: float = 0.0
    gathered_s: float = 0.0

    @property
    def ahead_s(self) -> float:
        """How long this client had answered while others had not."""
        return self.gathered_s - self.waited_s


class ClientSlot:
    """One client's place in the round, whether or not it is taken."""

    def __init__(
        self, block: tuple[int, ...], shape: tuple[int, int], layout: Layout, stats: BlockStats
    ) -> None:
        """A free slot for the client that holds the robots of `block`."""
        self.block, self.robots = block, list(block)
        self.rows = layout.rows_of(block)
        self.count = len(block) * layout.worlds
        robot = layout.worlds * layout.record.itemsize
        self._cuts = [slice(k * robot, (k + 1) * robot) for k in block]
        if isinstance(self.rows, slice):
            self._cuts = [slice(block[0] * robot, (block[-1] + 1) * robot)]
        longest = actions_size(len(block), layout)
        upload = upload_size(len(block), shape[1], layout)
        self.limit = max(TEXT_SIZE, longest, upload)
        self.stats = stats
        self.stream: FrameStream | None = None
        self.awaited = False
        self.windows: frozenset[int] = frozenset()  # of its last `Ready`
        self.stale = False  # what comes is older than the last `Halt` or `Begin`

    def records(self, fleet: bytes) -> bytes:
        """This slot's part of the bytes of all robots' records."""
        if len(self._cuts) == 1:
            return fleet[self._cuts[0]]
        return b"".join([fleet[cut] for cut in self._cuts])
