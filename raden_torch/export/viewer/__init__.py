"""The viewer's page, put together by `viewer_file.py`."""
