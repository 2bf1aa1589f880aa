"""Refuse LeRobot's own recorders where they would compress tactile images with loss.

LeRobot has one codec for all cameras, with loss unless its flags say otherwise, and gives no camera
its settings. They are read from the stack frame of the function that connects the robot.
"""

import inspect

from lerobot.configs.dataset import DatasetRecordConfig

from uniforce_vtla.errors import DatasetError, expected

# Measured with stored episodes: exact for images that hold only 0 and 255 with R = G = B.
LOSSLESS = (
    "--dataset.rgb_encoder.vcodec=h264 --dataset.rgb_encoder.crf=0"
    " --dataset.streaming_encoding=false"
)


def refuse_lossy_recording(label: str) -> None:
    """Refuse a LeRobot recorder that would store a tactile sensor's images with loss.

    Raises DatasetError: saying which flags store the images exactly.
    """
    settings = _recorders_settings()
    if settings is None or not settings.video:
        return
    encoder = settings.rgb_encoder
    exact = encoder.vcodec == "h264" and encoder.crf == 0 and not encoder.extra_options
    # a late streaming encoder leaves frames out
    if exact and not settings.streaming_encoding:
        return
    came = f"{encoder.vcodec} crf {encoder.crf}, streaming_encoding={settings.streaming_encoding}"
    do = f"Record with uniforce record, or add {LOSSLESS}, or --dataset.video=false."
    raise DatasetError(expected(f"recording of {label}", "lossless video", came, do))


def _recorders_settings() -> DatasetRecordConfig | None:
    """Return the settings of the LeRobot recorder that is connecting this camera, if one is."""
    frame = inspect.currentframe()
    while frame is not None:
        settings = getattr(frame.f_locals.get("cfg"), "dataset", None)
        if isinstance(settings, DatasetRecordConfig):
            return settings
        frame = frame.f_back
    return None
