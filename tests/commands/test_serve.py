"""``gapscope serve``: what it prints, how it ends, and what it refuses."""

from __future__ import annotations

import json

from gapscope.many.archive import ArchiveServer


def interrupted(self, poll_interval: float = 0.5) -> None:
    raise KeyboardInterrupt


def test_it_says_where_it_is_and_ends_with_ctrl_c(gapscope, tmp_path, monkeypatch):
    monkeypatch.setattr(ArchiveServer, "serve_forever", interrupted)
    (tmp_path / "arm").mkdir()
    (tmp_path / "arm" / "diagnosis.json").write_text(json.dumps({"half": 1}))
    outcome = gapscope("serve", tmp_path)
    assert outcome.code == 0
    said, ended = outcome.out.splitlines()
    assert said.startswith("1 diagnosis at http://127.0.0.1:") and ended == "stopped"


def test_what_it_cannot_serve_is_bad_input(gapscope, tmp_path):
    missing = gapscope("serve", tmp_path / "none")
    assert missing.code == 2 and "is not a folder" in missing.err
    assert gapscope("serve", tmp_path, "--units-by", "robot").code == 2
    assert gapscope("serve", tmp_path, "--port", "70000").code == 2
