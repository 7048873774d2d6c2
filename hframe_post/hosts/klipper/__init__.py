"""What runs inside Klipper: linked as ``hframe_live`` into klippy/extras, or Kalico's plugins.

It imports nothing of hframe-post and needs neither it nor numpy: ``module`` is the extras module,
``kernel_file`` reads what ``model/kernel.py`` computed, ``native`` compiles ``hframe_live.c``.
"""

from .module import load_config as load_config
