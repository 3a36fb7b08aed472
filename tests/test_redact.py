"""What may be a secret is not in messages."""

from __future__ import annotations

import pytest

from fwclass.errors import ConfigError
from fwclass.redact import redacted, redacted_setting, redacted_words


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("see https://h.example:8443/a/SECRET?k=SECRET#SECRET!", "see https://h.example:8443/…"),
        ("https://user:SECRET@h.example", "https://h.example"),
        ("https://h.example/", "https://h.example/"),
        ("https://h.example?SECRET", "https://h.example/…"),
        ("'http://u@SECRET@[::1]:80/SECRET'", "'http://[::1]:80/…'"),
        ("https://SECRET:SECRET/SECRET@h/x", "https://…/…"),
        ("ftp://u:SECRET@h.example/SECRET", "ftp://h.example/…"),
        ("s3://key:SECRET@bucket/strips/a.las?X=SECRET", "s3://bucket/strips/a.las?…"),
        ("tcp://10.0.0.1:8786", "tcp://10.0.0.1:8786"),
        ("no address, a/b: c", "no address, a/b: c"),
    ],
)
def test_of_an_address_scheme_and_host_are_told(text, told):
    assert redacted(text) == told


def test_settings_and_command_lines():
    assert redacted_setting("schedule.webhook=h/SECRET") == "schedule.webhook=…"
    assert redacted_setting("schedule={webhook: SECRET}") == "schedule=…"
    assert redacted_setting("schedule.command=[a, SECRET]") == "schedule.command=…"
    assert redacted_setting("ground.slope=0.2") == "ground.slope=0.2"
    words = ["run", "--set", "schedule.webhook=SECRET", "--set=schedule.webhook=SECRET", "--out", "https://h/SECRET"]
    assert "SECRET" not in " ".join(redacted_words(words)) and redacted_words(["--set", "a.b=1"]) == ["--set", "a.b=1"]


def test_no_error_quotes_an_address():
    fault = ConfigError(
        "https://h/SECRET",
        where="https://h/SECRET",
        expected="https://h/SECRET",
        got="https://h/SECRET",
        do="https://h/SECRET",
    )
    assert "SECRET" not in str(fault) and "https://h/…" in fault.got
