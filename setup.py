"""The compiled loops: optional, since numpy does the same where there is no compiler."""

from glob import glob

from setuptools import Extension, setup

KERNELS = Extension(
    "hframe_post.native._kernels",
    sorted(glob("hframe_post/native/*.c")),
    depends=["hframe_post/native/kernels.h"],
    extra_compile_args=["-O3", "-ffp-contract=off"],  # no fused multiply-add: the same bits
    optional=True,
)

setup(ext_modules=[KERNELS])
