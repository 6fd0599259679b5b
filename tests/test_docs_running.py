"""What runs the pages notices a page that is wrong."""

from __future__ import annotations

from contextlib import chdir
from pathlib import Path

import pytest
from docs_running import blocks_of, run_page

GOOD = """# A page
```yaml
# sub/my.yaml
structure: three_storey
```

```sh
rths new case.yaml
rths new case.yaml   # exit code 2
rths records \\
    el_centro
```

```text
duration          53.74  s
...
```

```python
value = open("sub/my.yaml").read()
```

<!-- not run: needs a table -->
```sh
rths run on_a_table
```

```python
assert value.startswith("# sub/my.yaml")
```
"""


def run(text: str, folder: Path) -> list[str]:
    (folder / "page.md").write_text(text, encoding="utf-8")
    with chdir(folder):
        return run_page(folder / "page.md")


def test_a_good_page_runs_in_order_and_tells_what_was_left_out(tmp_path: Path) -> None:
    from rths_cli.experiment.ground_motion_list import show

    shown = show("el_centro", None, None)[1].splitlines()[2]
    assert run(GOOD.replace("duration          53.74  s", shown), tmp_path) == ["needs a table"]
    assert (tmp_path / "case.yaml").exists() and [block.line for block in blocks_of(GOOD)][:2] == [2, 7]


@pytest.mark.parametrize(
    ("block", "said"),
    [
        ("```sh\nrths new case.yaml   # exit code 1\n```\n", "page.md:1: rths new case.yaml .*exit code 0"),
        ("```sh\nrths records nowhere\n```\n", "exit code 2\n.*nowhere"),
        ("```sh\nls\n```\n", "only commands of rths"),
        ("```sh\nrths records\n```\n\n```text\nnever printed\n```\n", "page.md:5: not printed, .*'never printed'"),
        (
            "```sh\nrths records el_centro\n```\n\n```text\npeak 3.9170 m/s^2, 0.3813 m/s\n```\n",
            "page.md:5: not printed",
        ),
        ("```yaml\nstructure: three_storey\n```\n", "the first line of a file is its name"),
        ("```bash\nrths records\n```\n", "a block is sh, yaml, python or text"),
        ("```\nrths records\n```\n", "a block is sh, yaml, python or text"),
    ],
)
def test_a_wrong_page_fails_with_its_line(block: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(AssertionError, match=said):
        run(block, tmp_path)


def test_code_that_raises_fails_the_page(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError):
        run("```python\n1 / 0\n```\n", tmp_path)
