"""Look at a tactile sensor while it works: raw signal, markers, latent force map, newtons; and two checks of it."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Literal

import cv2
import torch

from uniforce_cli.boundary import command
from uniforce_cli.option_types import Sensor
from uniforce_cli.touch_checks import QUARTERS, check_orientation, check_rate
from uniforce_cli.touch_live import LiveTouch
from uniforce_cli.touch_outputs import make_output, save_panel
from uniforce_robots.sensors import (
    UniforceTactileCamera,
    UniforceTactileCameraConfig,
    UniforceUskin,
    UniforceUskinConfig,
)
from uniforce_robots.sensors.finger import TactileFinger
from uniforce_vtla.contracts import check_finger
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.options import Names, NotNegative, OutFile, Positive, Range, Text, TokenizerFolder
from uniforce_vtla.sensors import get_sensor, list_sensors
from uniforce_vtla.tokenizer.api import Tokenizer
from uniforce_vtla.tokenizer.force_head import ForceHead

STAND_IN = "standin"


Controller = Annotated[int, Range(0, 15)]
Quarters = Annotated[str, Names(tuple(QUARTERS), many=True)]
NewtonsHead = Annotated[str, Names((*list_sensors(), "none"))]


@dataclass
class TouchConfig:
    """Show what a tactile sensor feels, live; or check its rate or which way up it is.

    Example: uniforce touch sensor=tactip finger=right source=/dev/v4l/by-path/pci-0000:00:14.0-usb-0:1:1.0-video-index0
    uSkin: uniforce touch sensor=uskin source=/dev/serial/by-id/usb-VScom_USB-CAN check=rate
    No hardware: uniforce touch sensor=uskin source=standin seconds=5
    """

    sensor: Sensor = "uskin"  # gelsight | tactip | uskin
    source: Text = ""  # camera: device or http://…; uskin: serial port or ws://host:port; or standin
    # who wears it: left | right; forces are in that finger's own frame
    finger: Literal["left", "right"] = "left"
    # window needs a display and an OpenCV with windows
    output: Literal["terminal", "window", "rerun"] = "terminal"
    # rate: measured rate, ages, losses | orientation: press where told; empty = live view
    check: Literal["", "rate", "orientation"] = ""
    seconds: NotNegative = 0.0  # how long; 0 = until Ctrl-C (a rate check then takes 5 s)
    refresh_hz: Positive = 10.0  # pictures per second
    rotation_deg: Literal[0, 90, 180, 270] = 0  # how the sensor is turned on its finger: 0 | 90 | 180 | 270
    flip: bool = False  # uskin: columns run the other way
    controller: Controller = 0  # uskin: microcontroller id in the low bits of its CAN ids
    lock_camera: bool = True  # lock exposure, white balance and gain; false leaves the camera's automatics
    # orientation: where to press, in this order
    quarters: Quarters = "top-left,top-right,bottom-left,bottom-right"
    tokenizer: TokenizerFolder = "nano"  # small | nano, or a checkpoint folder
    head: NewtonsHead = "tactip"  # the sensor whose shipped force head reads the latents; none = no newtons
    save: OutFile = ""  # write the last picture of the live view to this file


def make_finger(config: TouchConfig, source: str) -> TactileFinger:
    """Return the device that ``config`` names, not connected."""
    if get_sensor(config.sensor).signal == "camera":
        return UniforceTactileCamera(_camera_config(config, source))
    link = "server" if source.startswith("ws://") else "slcan"
    return UniforceUskin(
        UniforceUskinConfig(
            link=link,
            source=source,
            finger=config.finger,
            rotation_deg=config.rotation_deg,
            flip=config.flip,
            controller=config.controller,
            reference_on_connect=False,
        )
    )


def _camera_config(config: TouchConfig, source: str) -> UniforceTactileCameraConfig:
    is_stream = source.startswith("http://")
    settings = UniforceTactileCameraConfig(
        sensor=config.sensor,
        source=source,
        finger=config.finger,
        rotation_deg=config.rotation_deg,
        reference_on_connect=False,
    )
    if is_stream:
        settings.capture_width = settings.capture_height = None  # its server decides
    if not config.lock_camera:
        settings.exposure_100us = settings.white_balance_K = settings.gain = None
    return settings


@contextlib.contextmanager
def opened(config: TouchConfig) -> Iterator[TactileFinger]:
    """Connect the sensor, or a stand-in of it in a process of its own, and take its free-air reference."""
    with contextlib.ExitStack() as stack:
        source = config.source
        if source == STAND_IN:
            source = _start_stand_in(stack, config.sensor)
        finger = stack.enter_context(make_finger(config, source))
        print(f"{finger.config.label}: taking the reference, keep it in free air")
        finger.take_reference()
        yield finger


def _start_stand_in(stack: contextlib.ExitStack, sensor: str) -> str:
    from uniforce_robots.standins.process import StandIn

    print("starting a stand-in: simulated touch, no hardware")
    options = ("slcan", "rate_hz=100") if sensor == "uskin" else ("mjpeg", f"sensor={sensor}")
    return stack.enter_context(StandIn(*options, "rest_s=2")).address


def show(config: TouchConfig) -> None:
    """Show the live view until ``config.seconds`` are over; what reads images is loaded before a device is opened."""
    tokenizer = Tokenizer.from_pretrained(config.tokenizer)
    head = ForceHead.from_pretrained(config.head, config.tokenizer) if config.head != "none" else None
    with opened(config) as finger:
        _show(config, finger, tokenizer, head)


def _show(config: TouchConfig, finger: TactileFinger, tokenizer: Tokenizer, head: ForceHead | None) -> None:
    label = finger.config.label + (" (stand-in)" if config.source == STAND_IN else "")
    live = LiveTouch(finger, check_finger(config.finger), tokenizer, head, label)
    end_s = time.monotonic() + (config.seconds or math.inf)
    with make_output(config.output) as output:
        while time.monotonic() < end_s and output.is_open:
            began_s = time.monotonic()
            view = live.look()
            output.show(view)
            time.sleep(max(began_s + 1 / config.refresh_hz - time.monotonic(), 0))
    if config.save:
        print(f"picture in {save_panel(view, config.save)}")


def run(config: TouchConfig) -> int:
    """Do what ``config`` asks; return the exit code: 1 when a check failed."""
    if not config.source:
        do = "Set source=DEVICE, or source=standin to try without hardware."
        raise ContractError(expected("source", "a device", "nothing", do))
    if not config.check:
        show(config)
        return 0
    with opened(config) as finger:
        if config.check == "rate":
            return check_rate(finger, config.seconds or 5.0)
        return check_orientation(finger, config.quarters.split(","), config.seconds or 60.0)


@command(TouchConfig)
def main(config: TouchConfig) -> int:
    """Entry of ``uniforce touch``."""
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    try:
        return run(config)
    except KeyboardInterrupt:
        return 0
