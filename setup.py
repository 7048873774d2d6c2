"""The compiled loops: optional, since numpy does the same where there is no compiler."""

import sys
from glob import glob

from setuptools import Extension, setup

# no fused multiply-add: the same bits; roots are instructions, which loops can do side by side
EXACT = ["-O3", "-ffp-contract=off", "-fno-math-errno"]
KERNELS = Extension(
    "hframe_post.native._kernels",
    sorted(glob("hframe_post/native/*.c")),
    depends=glob("hframe_post/native/*.h"),
    define_macros=[("Py_LIMITED_API", "0x030B0000")],  # one build for all Pythons from 3.11 on
    py_limited_api=True,
    extra_compile_args=["/O2", "/fp:precise"] if sys.platform == "win32" else EXACT,
    optional=True,
)

setup(ext_modules=[KERNELS], options={"bdist_wheel": {"py_limited_api": "cp311"}})
