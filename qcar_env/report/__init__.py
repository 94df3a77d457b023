"""Results as one HTML file that opens offline. The only place with plotly and jinja2."""

from importlib.util import find_spec


def check_installed() -> None:
    """Raise ValueError where what writes a page is absent."""
    for name in ("plotly", "jinja2"):
        if find_spec(name) is None:
            raise ValueError(f"a report needs {name}: pip install 'qcar_env[report]'")
