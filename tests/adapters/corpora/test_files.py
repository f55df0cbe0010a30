"""Narration files: what they hold, or a clear no."""

from __future__ import annotations

from prbench_adapters.corpora.nymeria.files import read_narrations

HEADER = "request_id,gaia_id,start_time,end_time,annotator,creation_time,"


def write(tmp_path, text: str, *, encoding: str = "utf-8"):
    path = tmp_path / "atomic_action.csv"
    path.write_bytes(text.encode(encoding))
    return path


def test_rows_are_read_with_quotes_commas_and_byte_order_mark(tmp_path):
    text = f'{HEADER}"Describe my atomic actions"\r\n1,2,"10.5","14.5",ann,x,"C turns, then says ""hello""."\r\n'
    (row,) = read_narrations(write(tmp_path, text, encoding="utf-8-sig"), "atomic_action")
    assert (row.start, row.end, row.annotator) == (10.5, 14.5, "ann")
    assert row.texts == (("atomic actions", 'C turns, then says "hello".'),)


def test_answer_columns_are_found_by_the_beginning_of_their_name(tmp_path):
    text = "end_time,DESCRIBE MY Body Posture,start_time,Describe my focus attention,other\n4,upright,1,ahead,z\n"
    (row,) = read_narrations(write(tmp_path, text), "motion_narration")
    assert row.texts == (("Body Posture", "upright"), ("focus attention", "ahead"))
    assert (row.start, row.end, row.annotator) == (1.0, 4.0, "")


def test_a_byte_order_mark_is_no_part_of_the_first_column(tmp_path):
    text = "start_time,end_time,Describe my activity\n1,4,C sits.\n"
    (row,) = read_narrations(write(tmp_path, text, encoding="utf-8-sig"), "activity_summarization")
    assert (row.start, row.end) == (1.0, 4.0)


def test_an_empty_file_has_no_rows_and_empty_answers_are_kept(tmp_path):
    assert read_narrations(write(tmp_path, ""), "atomic_action") == ()
    assert read_narrations(write(tmp_path, f"{HEADER}Describe my activity\n"), "atomic_action") == ()
    (row,) = read_narrations(write(tmp_path, f"{HEADER}Describe my activity\n1,2,3,7,a,x,\n\n"), "atomic_action")
    assert row.texts == (("activity", ""),)
