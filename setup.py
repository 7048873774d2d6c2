"""The compiled loops. Where no C compiler is found, ``build_backend`` brings one."""

import os
import sys
from glob import glob

from build_backend import compiler_is_missing
from setuptools import Extension, setup

if compiler_is_missing():  # the build backend has brought one, which must not trap on overflows
    zig = f"{sys.executable} -m ziglang cc -mcpu=baseline -fno-sanitize=undefined"
    os.environ |= {"CC": zig, "LDSHARED": f"{zig} -shared"}

# no fused multiply-add: the same bits; roots are instructions, which loops can do side by side
EXACT = ["-O3", "-ffp-contract=off", "-fno-math-errno"]
KERNELS = Extension(
    "hframe_post.native._kernels",
    sorted(glob("hframe_post/native/*.c")),
    depends=glob("hframe_post/native/*.h"),
    define_macros=[("Py_LIMITED_API", "0x030B0000")],  # one build for all Pythons from 3.11 on
    py_limited_api=True,
    extra_compile_args=["/O2", "/fp:precise"] if sys.platform == "win32" else EXACT,
)

setup(ext_modules=[KERNELS], options={"bdist_wheel": {"py_limited_api": "cp311"}})
