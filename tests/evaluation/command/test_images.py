"""`elf-eval images`."""

from __future__ import annotations

from elf_eval.command.main import main


def test_images_are_written_under_the_names_that_precomputed_features_use(hpatches_folder, tmp_path, capsys):
    assert main(["images", f"scale:{hpatches_folder}", "--out", str(tmp_path / "i"), "--size", "160x120"]) == 0
    assert (tmp_path / "i" / "v_turn" / "1@scale-1.25.png").is_file()
    assert "10 images" in capsys.readouterr().out
