"""Video while recording: a codec per key, and no frame lost in silence.

LeRobot 0.6.1 knows one codec per dataset and drops a frame with a log line when its queue is full.
"""

import queue
import tempfile
import threading
import time
from pathlib import Path

import av
import numpy as np
from lerobot.configs import RGBEncoderConfig
from lerobot.datasets.video_utils import StreamingVideoEncoder

from uniforce_datasets.encoder_thread import EncoderThread
from uniforce_vtla.contracts import FINGERS
from uniforce_vtla.errors import DatasetError, expected
from uniforce_vtla.keys import TACTILE_KEYS, tactile_key, tactile_name

PATIENCE_s = 60.0  # how long a simulation waits for a stuck encoder before it gives the episode up
POLL_s = 0.002  # between looks at a full queue
REFERENCE_KEYS = tuple(tactile_key(finger, reference=True) for finger in FINGERS)
RAW_NAMES = tuple(tactile_name(finger) for finger in FINGERS)  # of raw streams: names, never LeRobot keys


def camera_codec() -> RGBEncoderConfig:
    """H.264 at crf 23: 20–30 kB per noisy 640×480 frame; x264's fastest preset costs 2.7 ms of a core, the next 4.4."""
    return RGBEncoderConfig(vcodec="h264", crf=23, preset="ultrafast", g=2)


def marker_codec() -> RGBEncoderConfig:
    """H.264 at crf 0: exact for images that hold only 0 and 255 with R = G = B."""
    return RGBEncoderConfig(vcodec="h264", crf=0, preset="ultrafast", g=15)


def raw_codec() -> RGBEncoderConfig:
    """H.264 at crf 10, for raw tactile frames; docs/recording.md has what it costs and what it keeps."""
    return RGBEncoderConfig(vcodec="h264", crf=10, preset="ultrafast", g=15)


def codec_of(key: str) -> RGBEncoderConfig:
    """Return the codec a video key is stored with."""
    if key in RAW_NAMES:
        return raw_codec()
    return marker_codec() if key in TACTILE_KEYS else camera_codec()


class PerKeyEncoder(StreamingVideoEncoder):
    """LeRobot's streaming encoder with a codec per key, and threads of our own.

    Args:
        fps: frames per second of the videos.
        queue_frames: frames that may wait per key.
        realtime: True on hardware (a full queue loses the frame, which fails the episode);
            False in simulation (a full queue makes the simulation wait).
    """

    def __init__(self, fps: int, queue_frames: int, realtime: bool) -> None:
        super().__init__(fps=fps, rgb_encoder=camera_codec(), queue_maxsize=queue_frames, encoder_threads=1)
        self._realtime = realtime
        av.logging.set_libav_level(av.logging.ERROR)  # x264 prints a page per video otherwise

    def start_episode(self, video_keys: list[str], temp_dir: Path, depth_video_keys: list[str] | None = None) -> None:
        """Start one encoder per key, each with its own codec."""
        self.cancel_episode()
        self._dropped_frames.clear()
        for key in video_keys:
            self._start(key, temp_dir)
        self._episode_active = True

    def _start(self, key: str, temp_dir: Path) -> None:
        frames: queue.Queue = queue.Queue(self.queue_maxsize)
        result: queue.Queue = queue.Queue(1)
        stop, path = threading.Event(), Path(tempfile.mkdtemp(dir=temp_dir)) / f"{key}.mp4"
        thread = EncoderThread(path, self.fps, codec_of(key), frames, result, stop, encoder_threads=1)
        thread.still = key in REFERENCE_KEYS
        thread.start()
        self._frame_queues[key], self._result_queues[key] = frames, result
        self._threads[key], self._stop_events[key], self._video_paths[key] = thread, stop, path

    def feed_frame(self, video_key: str, image: np.ndarray) -> None:
        """Queue a frame; in simulation, wait for room first."""
        if not self._realtime:
            self._wait_for_room(video_key)
        super().feed_frame(video_key, image)

    def _wait_for_room(self, key: str) -> None:
        deadline = time.monotonic() + PATIENCE_s
        while self._frame_queues[key].full() and self._threads[key].is_alive():
            if time.monotonic() > deadline:
                raise DatasetError(
                    expected(key, "a video encoder that moves", f"none in {PATIENCE_s} s", "Free the machine.")
                )
            time.sleep(POLL_s)

    @property
    def dropped(self) -> dict[str, int]:
        """Frames lost in this episode, by key."""
        return {key: count for key, count in self._dropped_frames.items() if count}
