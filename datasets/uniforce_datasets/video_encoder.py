"""Video while recording: a codec per key, no frame lost in silence, and lean encoder threads.

LeRobot 0.6.1 knows one codec per dataset and drops a frame with a log line when its queue is full.
Its thread takes 5.5 ms of a core per 640×480 frame here, 2 ms of it for statistics of every frame,
and a recorder runs up to eight. Ours takes statistics of every fifth frame, as LeRobot itself
samples frames when it doesn't stream; the picture goes to x264 without a detour.
"""

import itertools
import queue
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from lerobot.configs import RGBEncoderConfig
from lerobot.datasets.compute_stats import RunningQuantileStats, auto_downsample_height_width
from lerobot.datasets.video_utils import StreamingVideoEncoder, _CameraEncoderThread

from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.errors import DatasetError, expected
from uniforce_vtla.keys import TACTILE_KEYS, tactile_name

LOOK_s = 0.1  # between looks at whether the episode was cancelled
CHANNELS = 3


class EncoderThread(_CameraEncoderThread):
    """LeRobot's thread with another way of working: same queues, same answer, same files.

    Attributes:
        stats_every: statistics are taken of every so-manyth frame.
        is_grey: R = G = B, as in marker images; OpenCV makes the same planes in a tenth of the
            time.
    """

    stats_every = 5
    is_grey = False

    def run(self) -> None:
        """Encode until ``None`` or a cancelled episode; answer statistics or an error."""
        try:
            self.result_queue.put(("ok", self._encode()))
        except (av.error.FFmpegError, OSError, ValueError, RuntimeError) as error:
            self.result_queue.put(("error", str(error)))

    def _encode(self) -> dict[str, Any] | None:
        statistics = RunningQuantileStats()
        first = next(self._frames(), None)
        if first is None:
            return None
        with closing(av.open(str(self.video_path), "w")) as container:
            stream = self._stream(container, first)
            for number, frame in enumerate(itertools.chain([first], self._frames())):
                container.mux(stream.encode(self._picture(frame, number)))
                if number % self.stats_every == 0:
                    statistics.update(_pixels(frame))
            container.mux(stream.encode())
        if number == 0:  # quantiles of one frame are no quantiles
            return None
        if number < self.stats_every:
            statistics.update(_pixels(frame))  # a very short episode: its last frame too
        return statistics.get_statistics()

    def _frames(self) -> Iterator[np.ndarray]:
        while not self.stop_event.is_set():
            try:
                frame = self.frame_queue.get(timeout=LOOK_s)
            except queue.Empty:
                continue
            if frame is None:
                return
            yield frame

    def _stream(self, container: Any, frame: np.ndarray) -> Any:
        codec = self.video_encoder
        options = codec.get_codec_options(self.encoder_threads, as_strings=True)
        stream = container.add_stream(codec.vcodec, self.fps, options=options)
        stream.pix_fmt = codec.pix_fmt
        stream.time_base = Fraction(1, self.fps)
        stream.height = frame.shape[0]
        stream.width = frame.shape[1]
        return stream

    def _picture(self, frame: np.ndarray, number: int) -> av.VideoFrame:
        """Return an (h, w, 3) frame as a picture; its conversion costs more than its coding."""
        if self.is_grey:
            planes = cv2.cvtColor(frame, cv2.COLOR_RGB2YUV_I420)  # (1.5 h, w)
            picture = av.VideoFrame.from_ndarray(planes, format="yuv420p")
        else:
            picture = av.VideoFrame.from_ndarray(frame, format="rgb24")
        picture.pts = number
        picture.time_base = Fraction(1, self.fps)
        return picture


def _pixels(frame: np.ndarray) -> np.ndarray:
    """(N, 3) pixels of a frame made small, as LeRobot's statistics take them."""
    small = auto_downsample_height_width(frame.transpose(2, 0, 1))
    return small.transpose(1, 2, 0).reshape(-1, CHANNELS)


PATIENCE_s = 60.0  # how long a simulation waits for a stuck encoder before it gives the episode up
POLL_s = 0.002  # between looks at a full queue
# of raw streams: names, never LeRobot keys
RAW_NAMES = tuple(map(tactile_name, FINGERS))


def camera_codec() -> RGBEncoderConfig:
    """H.264 at crf 23: 20–30 kB per noisy 640×480 frame.

    x264's fastest preset costs 2.7 ms of a core, the next 4.4.
    """
    return RGBEncoderConfig(vcodec="h264", crf=23, preset="ultrafast", g=2)


def codec_of(key: str) -> RGBEncoderConfig:
    """Return the codec a video key is stored with.

    Marker images are exact at crf 0, since they hold only 0 and 255 with R = G = B. Raw tactile
    frames have crf 10: docs/recording.md says what it costs and what it keeps.
    """
    if key in RAW_NAMES:
        return RGBEncoderConfig(vcodec="h264", crf=10, preset="ultrafast", g=15)
    if key in TACTILE_KEYS:
        return RGBEncoderConfig(vcodec="h264", crf=0, preset="ultrafast", g=15)
    return camera_codec()


class PerKeyEncoder(StreamingVideoEncoder):
    """LeRobot's streaming encoder with a codec per key, and threads of our own.

    Args:
        fps: frames per second of the videos.
        queue_frames: frames that may wait per key.
        realtime: True on hardware (a full queue loses the frame, which fails the episode);
            False in simulation (a full queue makes the simulation wait).
    """

    def __init__(self, fps: int, queue_frames: int, realtime: bool) -> None:
        super().__init__(
            fps=fps, rgb_encoder=camera_codec(), queue_maxsize=queue_frames, encoder_threads=1
        )
        self._realtime = realtime
        av.logging.set_libav_level(av.logging.ERROR)  # x264 prints a page per video otherwise

    def start_episode(
        self, video_keys: list[str], temp_dir: Path, depth_video_keys: list[str] | None = None
    ) -> None:
        """Start one encoder per key, each with its own codec."""
        self.cancel_episode()
        self._dropped_frames.clear()
        for key in video_keys:
            self._start(key, temp_dir)
        self._episode_active = True

    def _start(self, key: str, temp_dir: Path) -> None:
        frames: queue.Queue = queue.Queue(self.queue_maxsize)
        result: queue.Queue = queue.Queue(1)
        stop = threading.Event()
        path = Path(tempfile.mkdtemp(dir=temp_dir)) / f"{key}.mp4"
        thread = EncoderThread(
            path, self.fps, codec_of(key), frames, result, stop, encoder_threads=1
        )
        thread.is_grey = key in TACTILE_KEYS
        thread.start()
        self._frame_queues[key] = frames
        self._result_queues[key] = result
        self._threads[key] = thread
        self._stop_events[key] = stop
        self._video_paths[key] = path

    def feed_frame(self, video_key: str, image: np.ndarray) -> None:
        """Queue a frame; in simulation, wait for room first."""
        if not self._realtime:
            self._wait_for_room(video_key)
        super().feed_frame(video_key, image)

    def _wait_for_room(self, key: str) -> None:
        deadline = time.monotonic() + PATIENCE_s
        while self._frame_queues[key].full() and self._threads[key].is_alive():
            if time.monotonic() > deadline:
                do = "Free the machine."
                raise DatasetError(
                    expected(key, "a video encoder that moves", f"none in {PATIENCE_s} s", do)
                )
            time.sleep(POLL_s)

    @property
    def dropped(self) -> dict[str, int]:
        """Frames lost in this episode, by key."""
        return {key: count for key, count in self._dropped_frames.items() if count}
