"""`elf-eval images`."""

from __future__ import annotations

from command_line import METHOD, error_of, write_suite

from elf_eval.cli import main


def test_images_are_written_under_the_names_that_precomputed_features_use(hpatches_folder, tmp_path, capsys):
    assert main(["images", f"scale:{hpatches_folder}", "--out", str(tmp_path / "i"), "--size", "160x120"]) == 0
    assert (tmp_path / "i" / "v_turn" / "1@scale-1.25.png").is_file()
    assert "10 images" in capsys.readouterr().out


def test_an_image_that_can_t_be_written_is_named(hpatches_folder, tmp_path, capsys):
    (tmp_path / "i" / "v_turn" / "1@scale-1.25.png").mkdir(parents=True)
    assert main(["images", f"scale:{hpatches_folder}", "--out", str(tmp_path / "i"), "--size", "160x120"]) == 1
    assert "1@scale-1.25.png" in capsys.readouterr().err


def test_a_picture_that_can_t_be_written_is_named(hpatches_folder, tmp_path, monkeypatch, capsys):
    picture = "[[picture]]\ndataset = 'two'\npair = 'v_turn/1.png - v_turn/2.png'\n"
    words = write_suite(tmp_path / "s.toml", hpatches_folder, [METHOD.format("SIFT", "sift"), picture])
    monkeypatch.setattr("elf_eval.report.pictures.cv2.imwrite", lambda *_: False)
    (line,) = error_of(words, capsys)
    assert line.startswith(str(tmp_path / "o" / "s" / "pictures"))
    assert line.endswith(".jpg: the picture can't be written")
