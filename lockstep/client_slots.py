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
        self, block: tuple[int, ...], parameters: int, layout: Layout, stats: BlockStats
    ) -> None:
        """A free slot for the client that holds the robots of `block`, of P parameters each."""
        self.block, self.robots = block, list(block)
        self.rows = layout.rows_of(block)
        self.count = len(block) * layout.worlds
        longest = max(actions_size(len(block), layout), upload_size(len(block), parameters, layout))
        self.limit = max(TEXT_SIZE, longest)
        self.stats = stats
        self.stream: FrameStream | None = None
        self.awaited = False
        self.windows: frozenset[int] = frozenset()  # of its last `Ack`
        self.stale = False  # what comes is older than the last `Abort` or `Restore`
