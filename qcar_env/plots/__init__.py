"""Figures: functions that take data and axes. The only place with matplotlib."""
