"""Files and folders of a wrong kind, for whatever option of a command names one: a new option is
tried, too."""

from dataclasses import dataclass
from pathlib import Path

from lerobot_policy_pi05_uniforce.controller import shipped_checkpoint
from uniforce_datasets.synthetic import record_synthetic
from uniforce_datasets.training_view import build_view
from uniforce_vtla.keys import VIEW_MARKER
from uniforce_vtla.options import Existing, Writable
from uniforce_vtla.tokenizer.weights import ASSETS, DEFAULT_SIZE

CONTENTS = {  # of files that a user may name by mistake
    "garbage": b"\xff\xfe{]garbage\x00" * 16,
    "empty": b"",
    "latin1": "robot: # Größe\n".encode("latin-1"),
    "list": b"[1, 2]",
    "number": b"7",
    "object": b'{"a": null}',
}
TOKENIZER = ASSETS / DEFAULT_SIZE / "tokenizer"


@dataclass(frozen=True)
class Room:
    """Sound and damaged files and folders to name on a command line."""

    folder: Path

    def build(self):
        record_synthetic(self.folder / "dataset", 1, 20)
        build_view(self.folder / "dataset", self.folder / "view")
        (self.folder / "some_folder").mkdir()
        for name, content in CONTENTS.items():
            (self.folder / name).write_bytes(content)
            for marker in ("meta/info.json", VIEW_MARKER, "config.json"):
                file = self.damaged(name, marker) / marker
                file.parent.mkdir(parents=True)
                file.write_bytes(content)
        return self

    def damaged(self, name, marker):
        """Return a file without a marker, or the folder whose marker it is."""
        if not marker:
            return self.folder / name
        return self.folder / f"{name}_{marker.replace('/', '_')}"

    def sound(self, marker):
        whole = {"meta/info.json": self.folder / "dataset", VIEW_MARKER: self.folder / "view"}
        return whole.get(marker, shipped_checkpoint())


def wrong_files(options, room):
    """Yield an option and a path that will not do, for all of both."""
    for option in options.values():
        if isinstance(option.rule, Writable):
            yield option.name, room.folder / ("garbage" if option.rule.folder else "some_folder")
        elif isinstance(option.rule, Existing):
            yield from ((option.name, path) for path in _wrong_sources(option.rule, room))


def _wrong_sources(rule, room):
    if rule.marker in ("", "."):
        yield room.folder / "some_folder"  # no file, or nothing in it
    if rule.marker:
        yield room.folder / "garbage"  # no folder
    if rule.marker == "config.json":  # of another kind
        yield TOKENIZER if "checkpoint" in rule.what else shipped_checkpoint()
    if rule.marker != ".":
        yield from (room.damaged(name, rule.marker) for name in CONTENTS)
