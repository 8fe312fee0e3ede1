"""Messages of others are shown in one line that ends between words."""

from hypothesis import given, settings
from hypothesis import strategies as st

from castor_envs.errors import Declined, InputError, message_of, one_line, shortened


@settings(deadline=None, max_examples=50)
@given(st.text(), st.integers(3, 60))
def test_a_shortened_text_is_a_printable_line_of_whole_words(text, limit):
    line = shortened(text, limit)
    assert len(line) <= limit
    assert line.isprintable()
    words = "".join(c if c.isprintable() else "?" for c in " ".join(text.split())).split(" ")
    if line.endswith(" …") and len(words[0]) <= limit - 2:
        assert words[: line.count(" ")] == line.split(" ")[:-1]
    elif not line.endswith(" …"):
        assert line.split(" ") == words


def test_an_end_that_is_cut_is_seen():
    assert shortened("look for an encoder that is dead, counts", 36) == "look for an encoder that is dead, …"
    assert shortened("look for an encoder that is dead, counts", 40) == "look for an encoder that is dead, counts"
    assert shortened("x" * 50, 10) == "xxxxxxxx …"
    assert shortened("word " * 10**6, 20) == "word word word …"


def test_a_message_that_cannot_be_made_is_no_error():
    class RudeError(Exception):
        def __str__(self):
            raise RuntimeError

    assert message_of(RudeError()) == "its message cannot be shown"
    assert one_line(RudeError()) == "RudeError: its message cannot be shown"
    assert one_line(KeyError()) == "KeyError"


def test_a_refusal_is_a_line_for_people_too():
    assert issubclass(Declined, InputError)
