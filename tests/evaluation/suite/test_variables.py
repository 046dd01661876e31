"""A suite's variables: where they stand in errors, and where they don't stand in results."""

from __future__ import annotations

from command_line import METHOD, error_of, write_suite

from elf_eval.cli import main


def test_methods_that_can_t_be_opened_are_a_line_each(hpatches_folder, tmp_path, monkeypatch, capsys):
    methods = [METHOD.format(name, f"elf:${{WHERE}}/{name}.onnx") for name in ("A", "B")]
    run = write_suite(tmp_path / "s.toml", hpatches_folder, [*methods, METHOD.format("SIFT", "sift")])
    line = "method 'A': elf:models/A.onnx: ELF model: no such file: models/A.onnx (WHERE is models, from [variables])"
    assert error_of(run, capsys) == [line, line.replace("A", "B")]
    write_suite(tmp_path / "s.toml", hpatches_folder, [method + "optional = true\n" for method in methods])
    assert error_of(run, capsys) == ["none of the methods can be opened", line, line.replace("A", "B")]
    monkeypatch.setenv("WHERE", "there")
    assert error_of(run, capsys)[1].endswith("no such file: there/A.onnx (WHERE is there, from the environment)")
    assert not (tmp_path / "o").exists()


def test_a_method_that_is_left_out_is_told_and_stays_out_of_the_pages_paths(hpatches_folder, tmp_path, capsys):
    methods = [METHOD.format("A", "elf:${WHERE}/A.onnx") + "optional = true\n", METHOD.format("SIFT", "sift")]
    assert main(write_suite(tmp_path / "s.toml", hpatches_folder, methods)) == 0
    told = capsys.readouterr()
    assert "left out: method 'A': elf:models/A.onnx" in told.err
    assert "(WHERE is models, from [variables])" in told.err
    assert "no such file: ${WHERE}/A.onnx" in told.out


def test_a_dataset_that_can_t_be_opened_says_where_its_folder_comes_from(tmp_path, capsys):
    run = write_suite(tmp_path / "s.toml", "nowhere", [METHOD.format("SIFT", "sift")])
    line = "hpatches:nowhere: no such folder: nowhere (DATA is nowhere, from [variables])"
    assert error_of(run, capsys) == [line]


def test_a_variable_that_is_not_set_is_named(hpatches_folder, tmp_path, monkeypatch, capsys):
    monkeypatch.delenv("NOT_THERE", raising=False)
    run = write_suite(tmp_path / "s.toml", hpatches_folder, [METHOD.format("A", "elf:${NOT_THERE}/A.onnx")])
    (line,) = error_of(run, capsys)
    assert "NOT_THERE is not set" in line
