"""Write the reproduction: page, claims, Table 1 and figures."""

from __future__ import annotations

import datetime
from dataclasses import dataclass
from pathlib import Path

from percept.report.folder import filled_folder
from percept.report.plain import dumps
from percept.reproduce.claims import Claim, judge_all
from percept.reproduce.published import Published

PAGE = "reproduction.html"


@dataclass(frozen=True)
class Written:
    """What was written.

    Attributes
    ----------
    folder : Path
    page : Path
        The HTML file in it.
    claims : tuple of Claim
        Every claim with its verdict.
    """

    folder: Path
    page: Path
    claims: tuple[Claim, ...]


def write_reproduction(published: Published, out_dir: str | Path, *, date: str | None = None) -> Written:
    """Judge every claim, draw every figure and write both.

    Parameters
    ----------
    published : Published
    out_dir : str or Path
        Folder, made where it does not exist; files of other names in it stay.
    date : str, optional
        Printed on the page; today where not given. It is in no other file.

    Returns
    -------
    Written

    Raises
    ------
    UsageError
        Where the folder is a file or cannot be written.
    """
    from percept.report.plates import draw_plates
    from percept.reproduce.adaptive import adapted_couplings, trade_off
    from percept.reproduce.document import build_document, claims_csv, table_csv
    from percept.reproduce.figures import drawings
    from percept.reproduce.page import render

    claims = judge_all(published)
    adapted, trade = adapted_couplings(published), trade_off(published)
    document = build_document(published, claims, adapted, trade)
    with filled_folder(out_dir, last=PAGE) as folder:
        texts = {
            "claims.json": dumps(document),
            "claims.csv": claims_csv(claims),
            "table1.csv": table_csv(document),
        }
        for name, text in texts.items():
            (folder / name).write_text(text, encoding="utf-8")
        plates = draw_plates(drawings(published, adapted, trade), folder / "figures")
        page = render(document, claims, plates, date=date or datetime.date.today().isoformat())
        (folder / PAGE).write_text(page, encoding="utf-8")
    return Written(Path(out_dir), Path(out_dir) / PAGE, tuple(claims))
