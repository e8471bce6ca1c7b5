import shutil
import subprocess

import pytest

from percept.cli import main


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish", "tcsh"])
def test_the_shell_accepts_the_script(shell, tmp_path, capsys):
    program = shutil.which(shell)
    if program is None:
        pytest.skip(f"there is no {shell} here")
    main(["doctor", "--completion", shell])
    script = tmp_path / "completion"
    script.write_text(capsys.readouterr().out)
    run = subprocess.run([program, "-n", str(script)], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["percept", "rep"], {"report"}),
        (["percept", "report", "--met"], {"--method"}),
        (["percept", "report", "--method", "bay"], {"bayesian"}),
        (["percept", "validate", "my"], {"my sessions.csv"}),
        (["percept", "report", "--out", "my"], {"my_folder"}),
    ],
    ids=["command", "option", "choice", "file", "folder"],
)
def test_bash_completes(words, expected, tmp_path, capsys):
    bash = shutil.which("bash")
    if bash is None:
        pytest.skip("there is no bash here")
    main(["doctor", "--completion", "bash"])
    (tmp_path / "completion").write_text(capsys.readouterr().out)
    (tmp_path / "my sessions.csv").write_text("")
    (tmp_path / "my_folder").mkdir()
    listed = " ".join(f"'{word}'" for word in words)
    asked = (
        f"source ./completion; COMP_WORDS=({listed}); COMP_CWORD={len(words) - 1}; "
        'COMP_LINE="${COMP_WORDS[*]}"; COMP_POINT=${#COMP_LINE}; '
        '_shtab_percept; printf "%s\\n" "${COMPREPLY[@]}"'
    )
    run = subprocess.run(
        [bash, "--norc", "-c", asked], capture_output=True, text=True, cwd=tmp_path, check=False
    )
    found = {line.strip() for line in run.stdout.splitlines() if line.strip()}
    assert expected <= found, run.stderr
    assert not {"fit"} & found


def test_an_unknown_shell_is_refused(capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["doctor", "--completion", "elvish"])
    assert stopped.value.code == 2
    assert "tcsh" in capsys.readouterr().err
