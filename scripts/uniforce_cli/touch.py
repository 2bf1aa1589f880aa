"""Look at a tactile sensor while it works: raw signal, markers, latent force map, newtons.

And checks of it.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

from uniforce_cli.boundary import Sensor, command, one_thread
from uniforce_vtla.contracts import QUARTERS
from uniforce_vtla.errors import ContractError, expected
from uniforce_vtla.options import (
    Names,
    NotNegative,
    OutFile,
    Positive,
    Range,
    Text,
    TokenizerFolder,
    split,
)
from uniforce_vtla.sensors import get_sensor, list_sensors

if TYPE_CHECKING:
    from uniforce_robots.sensors.finger import TactileFinger

STAND_IN = "standin"
Controller = Annotated[int, Range(0, 15)]
Degrees = Annotated[float, Range(0, 359.999)]
Quarters = Annotated[str, Names(QUARTERS, many=True)]
NewtonsHead = Annotated[str, Names((*list_sensors(), "none"))]


@dataclass
class TouchConfig:
    """Show what a tactile sensor measures, live.

    Or check its rate, which way up it is, or its angle.

    Example: uniforce touch sensor=tactip finger=right source=/dev/v4l/by-path/…-video-index0
    uSkin: uniforce touch sensor=uskin source=/dev/serial/by-id/usb-VScom_USB-CAN check=rate
    No hardware: uniforce touch sensor=uskin source=standin seconds=5
    """

    sensor: Sensor = "uskin"  # what it is
    # camera: device or http://…; uskin: serial port or ws://host:port; or standin
    source: Text = ""
    # that wears it; forces are in that finger's own frame
    finger: Literal["left", "right"] = "left"
    output: Literal["terminal", "rerun"] = "terminal"  # rerun needs rerun-sdk
    # rate, ages, losses | press where asked | drag the skin: the angle on its mount; empty = live
    # view
    check: Literal["", "rate", "orientation", "angle"] = ""
    seconds: NotNegative = 0.0  # how long; 0 = until Ctrl-C (a rate check then takes 5 s)
    refresh_hz: Positive = 10.0  # pictures per second
    # how the sensor is turned on its finger, counter-clockwise; taxels by quarters
    rotation_deg: Degrees = 0.0
    flip: bool = False  # uskin: columns run the other way
    controller: Controller = 0  # uskin: microcontroller id in the low bits of its CAN ids
    # lock exposure, white balance and gain; false leaves the camera's automatics
    lock_camera: bool = True
    # orientation: where to press, in order
    quarters: Quarters = "top-left,top-right,bottom-left,bottom-right"
    tokenizer: TokenizerFolder = "small"  # makes the latents: the one that policies feel with
    # the sensor whose shipped force head reads the latents; none = no newtons
    head: NewtonsHead = "tactip"
    # write the last picture of the live view to this file
    save: OutFile = ""


def make_finger(config: TouchConfig, source: str) -> TactileFinger:
    """Return the device that ``config`` names, not connected."""
    from uniforce_robots import sensors

    common: dict[str, Any] = {
        "source": source,
        "finger": config.finger,
        "rotation_deg": config.rotation_deg,
    }
    common["reference_on_connect"] = False
    if get_sensor(config.sensor).signal != "camera":
        link = "server" if source.startswith("ws://") else "slcan"
        taxels: dict[str, Any] = {
            "sensor": config.sensor,
            "flip": config.flip,
            "controller": config.controller,
        }
        common |= taxels
        return sensors.UniforceUskin(sensors.UniforceUskinConfig(link=link, **common))
    camera = sensors.UniforceTactileCameraConfig(sensor=config.sensor, **common)
    if source.startswith("http://"):
        camera.capture_width = camera.capture_height = None  # its server decides
    if not config.lock_camera:
        camera.exposure_100us = camera.white_balance_K = camera.gain = None
    return sensors.UniforceTactileCamera(camera)


@contextlib.contextmanager
def opened(config: TouchConfig) -> Iterator[TactileFinger]:
    """Connect the sensor, or a stand-in in its own process, and take the reference."""
    from uniforce_robots.standins.process import StandIn

    with contextlib.ExitStack() as stack:
        source = config.source
        if source == STAND_IN:
            print("starting a stand-in: simulated touch, no hardware")
            taxels = get_sensor(config.sensor).signal != "camera"
            options = ("slcan", "rate_hz=100") if taxels else ("mjpeg", f"sensor={config.sensor}")
            source = stack.enter_context(StandIn(*options, "rest_s=2")).address
        finger = stack.enter_context(make_finger(config, source))
        print(f"{finger.config.label}: taking the reference, keep it in free air")
        finger.take_reference()
        yield finger


def show(config: TouchConfig) -> None:
    """Show the live view until ``config.seconds`` are over.

    The networks are loaded before a device is opened.
    """
    from uniforce_cli.touch_view import OUTPUTS, save_panel, views
    from uniforce_vtla.force_sensor import ForceSensor

    head = None if config.head == "none" else config.head
    sensor = ForceSensor(config.sensor, config.finger, tokenizer=config.tokenizer, head=head)
    output = OUTPUTS[config.output]()
    with opened(config) as finger:
        label = finger.config.label + (" (stand-in)" if config.source == STAND_IN else "")
        now_s = time.monotonic()
        end_s = now_s + (config.seconds or math.inf)
        shown = None
        try:
            for shown in views(finger, sensor, label):
                output(shown)
                time.sleep(max(now_s + 1 / config.refresh_hz - time.monotonic(), 0))
                now_s = time.monotonic()
                if now_s >= end_s:
                    break
        finally:  # Ctrl-C is the usual end
            if config.save and shown is not None:
                print(f"picture in {save_panel(shown, config.save)}")


def run(config: TouchConfig) -> int:
    """Do what ``config`` asks; return the exit code: 1 when a check failed."""
    if not config.source:
        do = "Set source=DEVICE, or source=standin to try without hardware."
        raise ContractError(expected("source", "a device", "nothing", do))
    if not config.check:
        show(config)
        return 0
    from uniforce_cli.touch_checks import check_angle, check_orientation, check_rate

    with opened(config) as finger:
        if config.check == "rate":
            return check_rate(finger, config.seconds or 5.0)
        if config.check == "angle":
            return check_angle(finger, config.seconds or 60.0)
        return check_orientation(finger, split(config.quarters), config.seconds or 60.0)


@command(TouchConfig)
def main(config: TouchConfig) -> int:
    one_thread()
    try:
        return run(config)
    except KeyboardInterrupt:
        return 0
