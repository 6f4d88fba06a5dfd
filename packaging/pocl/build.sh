#!/usr/bin/env bash
# build.sh POCL OUT: a wheel of PoCL from the checkout POCL into the folder OUT; see README.md, also for what of it has run
set -euo pipefail
source=$(realpath "$1")
mkdir -p "$2"
out=$(realpath "$2")
llvm=19

apt-get update -qq
# the libraries of LLVM, of its linker and of Polly are linked into libpocl
apt-get install -y -qq --no-install-recommends cmake ninja-build g++ pkg-config python3-venv patchelf git \
    "llvm-$llvm-dev" "llvm-$llvm-tools" "clang-$llvm" "libclang-$llvm-dev" "libclang-cpp$llvm-dev" "liblld-$llvm-dev" \
    "libpolly-$llvm-dev" libhwloc-dev libxml2-dev libedit-dev libz3-dev zlib1g-dev libzstd-dev libcurl4-openssl-dev \
    ocl-icd-opencl-dev opencl-headers

work=$(mktemp -d)
# all of x86-64 in one library ("distro"); its data are found beside it (relocation, the default)
cmake -S "$source" -B "$work/build" -G Ninja -DCMAKE_BUILD_TYPE=Release -DCMAKE_INSTALL_PREFIX="$work/tree" \
    -DWITH_LLVM_CONFIG="/usr/bin/llvm-config-$llvm" -DSTATIC_LLVM=ON -DENABLE_LOADABLE_DRIVERS=OFF -DENABLE_SPIRV=OFF \
    -DKERNELLIB_HOST_CPU_VARIANTS=distro -DENABLE_TESTS=OFF -DENABLE_EXAMPLES=OFF | tee "$work/configured"
grep -q 'CPU_USE_LLD_LINK: ON' "$work/configured"  # else it would need ld
ninja -C "$work/build" install

version=$(sed -n 's/^Version: \([0-9.]*\).*/\1/p' "$(find "$work/tree" -name pocl.pc)")  # without "-pre main-0-g..."
stage=$work/wheel
mkdir -p "$stage/pyopencl/.libs" "$stage/pyopencl/share" "$stage/pocl_in_process-$version.dist-info"
cp -L "$(find "$work/tree" -name 'libpocl.so' | head -1)" "$stage/pyopencl/.libs/"
cp -r "$work/tree/share/pocl" "$stage/pyopencl/share/"
echo libpocl.so >"$stage/pyopencl/.libs/pocl.icd"
printf 'Metadata-Version: 2.1\nName: pocl-in-process\nVersion: %s\nLicense: MIT\n' "$version" >"$stage/pocl_in_process-$version.dist-info/METADATA"
printf 'Wheel-Version: 1.0\nRoot-Is-Purelib: false\nTag: py3-none-linux_%s\n' "$(uname -m)" >"$stage/pocl_in_process-$version.dist-info/WHEEL"
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet wheel auditwheel
"$work/venv/bin/wheel" pack --dest-dir "$work" "$stage"
"$work/venv/bin/auditwheel" repair --wheel-dir "$out" "$work"/pocl_in_process-*.whl
# no linker in sight: a kernel must run
"$work/venv/bin/pip" install --quiet pyopencl numpy "$out"/pocl_in_process-*.whl
mkdir "$work/none"  # nor another PoCL: the loader would find the system's
env -i PATH="$work/none" OCL_ICD_VENDORS="$work/none" "$work/venv/bin/python" - <<'PYTHON'
import numpy as np
import pyopencl as cl

context = cl.create_some_context(interactive=False)
queue = cl.CommandQueue(context)
kernel = cl.Program(context, "kernel void f(global float *a) { a[get_global_id(0)] = 1.0f; }").build().f
got = cl.Buffer(context, cl.mem_flags.READ_WRITE, 32)
kernel(queue, (8,), None, got)
result = np.zeros(8, np.float32)
cl.enqueue_copy(queue, result, got)
assert (result == 1).all(), result
PYTHON
