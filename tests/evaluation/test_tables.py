from qcar_env.evaluation.tables import columns, markdown, plain


def test_a_markdown_table_sets_numbers_to_the_right_and_escapes_bars():
    lines = markdown(("name", "rho"), [("a|b", "0.5"), ("", "1")], right="lr")
    assert lines == ["| name | rho |", "|---|--:|", "| a\\|b | 0.5 |", "| | 1 |"]


def test_columns_are_as_wide_as_their_widest_cell():
    text = columns([["law", "G"], ["cnvc", "1.2"]], left=1)
    assert text.splitlines() == ["law     G", "----  ---", "cnvc  1.2"]


def test_words_of_an_error_are_no_markup():
    """A comment that is begun hides the rest of a leaderboard."""
    assert plain("- a_b failed: <!-- | `x` $1") == r"- a_b failed: \<!-- \| \`x\` \$1"
