"""What needs a browser is collected where there is one; scripts/test-browser installs one."""

from support import browser

collect_ignore = [] if browser.found() else ["test_look_in_browser.py"]
