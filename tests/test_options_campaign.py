"""The campaign that packs with every pair of options finds what goes wrong."""

from pathlib import Path

import pytest

from campaigns import options
from packit_sim.parts.filling.packed import PackedParts


@pytest.fixture
def inputs(tmp_path: Path) -> Path:
    folder = tmp_path / "inputs"
    options.make_inputs(folder)
    return folder


def test_two_options_give_a_packing_or_one_line(inputs: Path) -> None:
    packed = options.tried(("--clearance 1mm", "--even"), inputs)
    assert (packed["outcome"], packed["text"]) == ("packed", "")
    refused = options.tried(("--insertable", "--even"), inputs)
    assert refused["outcome"] == "refused"
    assert refused["text"].startswith("error: even is not possible with constraints")


def test_an_error_of_ours_is_wrong(inputs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(_: PackedParts) -> int:
        raise ZeroDivisionError("planted")

    monkeypatch.setattr(PackedParts, "count", property(broken))
    found = options.tried(("--clearance 1mm", "--seed 3"), inputs)
    assert found["outcome"] == "wrong"
    assert "planted" in found["text"]


def test_a_packing_that_does_not_verify_is_wrong(
    inputs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran = options._run

    def spoiled(words: list[str], folder: Path) -> tuple[int | None, str]:
        if words[0] == "verify":
            (folder / "out" / "meshes").rename(folder / "elsewhere")
        return ran(words, folder)

    monkeypatch.setattr(options, "_run", spoiled)
    found = options.tried(("--clearance 1mm", "--seed 3"), inputs)
    assert found["outcome"] == "wrong"
    assert found["text"].startswith("does not verify: ")


@pytest.mark.slow
@pytest.mark.parametrize("option", options.OPTIONS)
def test_no_option_is_refused_for_itself(option: str, inputs: Path) -> None:
    """Else it would be refused with all others, and nothing would be tried."""
    found = options.tried((option, "--unit mm"), inputs)
    assert found["outcome"] == "packed", found["text"]


def test_every_option_is_tried_with_every_other() -> None:
    words = {word for option in options.OPTIONS for word in option.split()}
    from typer.main import get_command

    from packit_sim.cli.app import app

    pack = get_command(app).commands["pack"]  # type: ignore[attr-defined]
    every = {name for option in pack.params for name in option.opts if name.startswith("--")}
    others = {"--out", "--iterations", "--workers", "--force", "--backend", "--address"}
    presets = {"--preset", "--save-preset", "--help"}
    assert every - words - others - presets == set()
