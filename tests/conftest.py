from __future__ import annotations

from hypothesis import settings

# Examples vary in cost with what else the machine does; a deadline would measure that.
settings.register_profile("house", deadline=None)
settings.load_profile("house")
