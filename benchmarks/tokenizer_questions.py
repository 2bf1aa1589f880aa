"""What else is asked of a tokenizer: force in a user's own recordings."""

from pathlib import Path
from typing import Any

from benchmarks.probes.labelled_set import LabelledSet
from benchmarks.probes.recorded_set import WindowConfig, of_indenters, of_sensor, shear_agreement, to_labelled_set
from benchmarks.probes.zero_shot import POOL, Table, descriptor_row, encode_set, learnt_row, mean_row
from uniforce_datasets.readers import read_genforce
from uniforce_vtla.contact.indenters import SEEN, UNSEEN
from uniforce_vtla.errors import DatasetError, expected
from uniforce_vtla.results_file import provenance, write_json
from uniforce_vtla.tokenizer.api import Tokenizer


def user_data(tokenizer: Tokenizer, folder: str, seeds: int, results: Path) -> str:
    """Write the force table on a user's force-labelled recordings (GenForce layout: seen → unseen indenters).

    Raises:
        DatasetError: an unknown format, or fewer than two sensors with both kinds of indenters.
    """
    windows, side = WindowConfig(), tokenizer.config.side
    sensors = sorted({recording.sensor for recording in read_genforce(folder)})
    if len(sensors) < 2:
        do = "A transfer needs a source and a target sensor."
        raise DatasetError(expected(folder, "two sensors or more", sensors, do))

    def sets(indenters: tuple[str, ...]) -> dict[str, LabelledSet]:
        found = {s: of_indenters(of_sensor(read_genforce(folder), s), indenters) for s in sensors}
        return {s: to_labelled_set(recordings, side, windows) for s, recordings in found.items()}

    table = Table(sets(SEEN), sets(UNSEEN))
    content: dict[str, Any] = {
        "what": f"GenForce recordings in {folder}; heads trained on seen, scored on unseen indenters",
        "tokenizer_hash": tokenizer.hash,
        "seeds": seeds,
        "shear_agreement": {s: shear_agreement(table.training[s]).tolist() for s in sensors},
        "rows": {
            "UniForce": learnt_row(table, lambda s: encode_set(tokenizer, s), seeds, POOL),
            "hand descriptor": descriptor_row(table, seeds),
            "mean": mean_row(table),
        },
    }
    path = write_json(results / "force_on_data.json", content | provenance())
    lines = [f"{name}: R² {_short(cell['r2'])}" for name, cell in content["rows"]["UniForce"].items()]
    return "\n".join([*lines, f"written to {path}; check shear_agreement: −1 there means a wrong sign"])


def _short(values: list[float]) -> str:
    return ", ".join(f"{value:.2f}" for value in values)
