"""Short ways to read a text as a file, for tests."""

import pytest

from percept import Scene
from percept.errors import UsageError
from percept.sessions import read_sessions

#: Headers of a study of stiffness, alone and beside damping.
HEAD = "subject,environment,k_ref,k_adj\n"
BOTH = "subject,environment,k_ref,b_ref,trial,k_adj,b_adj\n"


def read(folder, text, name="f.csv", **tables):
    """Read a text as a file, under tables of a scene."""
    path = folder / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return read_sessions(path, scene=Scene(**tables))


def refusal(folder, text, name="f.csv", **tables):
    """Read what is refused; give the error."""
    with pytest.raises(UsageError) as caught:
        read(folder, text, name, **tables)
    return caught.value


def texts(sessions):
    """What the reader said of a study."""
    return [notice.text for notice in sessions.notices]


def cells(sessions, *columns):
    """Rows of a study's table, as lists."""
    return sessions.table[list(columns)].to_numpy().tolist()
