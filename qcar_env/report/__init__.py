"""Results as one HTML file that opens offline. The only place with plotly and jinja2."""
