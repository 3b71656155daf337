#!/usr/bin/env bash
# Tests of the C and C++ interface against an installed library: run.sh PREFIX.
# Environment: ASAN=1 if the library itself was built with AddressSanitizer; CC, CXX.
set -euo pipefail
cd "$(dirname "$0")/../.."
prefix=$(realpath "$1")
out=$prefix/../tests
rm -rf "$out"
mkdir -p "$out"
out=$(realpath "$out")
CC=${CC:-cc}
CXX=${CXX:-c++}
version=$(sed -n 's/^version = "\(.*\)"$/\1/p' Cargo.toml | head -n 1)

strict="-Wall -Wextra -Wpedantic -Werror"
warnings="$strict -Wconversion -Wshadow"
sanitize="-fsanitize=address,undefined -fno-sanitize-recover=all -g"
export PKG_CONFIG_PATH=$prefix/lib/pkgconfig
flags=$(pkg-config --cflags svbrdf_gcn)
libs="$(pkg-config --libs svbrdf_gcn) -Wl,-rpath,$prefix/lib"

passed=0
failed=0
# step NAME COMMAND...: runs a command; what it printed is shown if it fails.
step() {
    local name=$1
    shift
    local begun=$SECONDS status
    # Not as a condition: bash would go on after failures inside.
    set +e
    (set -e; "$@") >"$out/log" 2>&1
    status=$?
    set -e
    if [ "$status" = 0 ]; then
        passed=$((passed + 1))
        echo "ok      $name ($((SECONDS - begun)) s)"
    else
        failed=$((failed + 1))
        echo "FAILED  $name: $*"
        cat "$out/log"
    fi
}

c99() { $CC -std=c99 $warnings -O1 $flags "$@" -lm -pthread; }
cpp17() { $CXX -std=c++17 $strict -O1 $flags "$@" -pthread; }

headers_compile() {
    printf '#include <svbrdf_gcn/svbrdf_gcn.h>\n' >"$out/header.c"
    cp "$out/header.c" "$out/header.cpp"
    printf '#include <svbrdf_gcn/svbrdf_gcn.hpp>\n#include <svbrdf_gcn/svbrdf_gcn.hpp>\n' >"$out/wrapper.cpp"
    $CC -std=c99 $strict $flags -fsyntax-only "$out/header.c"
    $CXX -std=c++17 $strict $flags -fsyntax-only "$out/header.cpp"
    $CXX -std=c++17 $strict -Wshadow $flags -fsyntax-only "$out/wrapper.cpp"
}

# The program of the README, and the one in it is all there is of C++.
readme_program() {
    awk '/^```cpp/ { inside = 1; next } /^```/ { inside = 0 } inside' README.md >"$out/readme.cpp"
    cpp17 "$out/readme.cpp" $libs -o "$out/readme"
    (cd "$out" && ln -sfn "$small" my-capture && ./readme && [ -s my-material/diffuse.png ])
}

# No symbol but ours, and all that the header declares.
symbols() {
    nm -D --defined-only "$prefix/lib/libsvbrdf_gcn.so" | awk '{ print $3 }' | sort >"$out/exported"
    grep -v '^svbrdf_gcn_' "$out/exported" && return 1
    grep -o 'svbrdf_gcn_[a-z_0-9]*(' "$prefix/include/svbrdf_gcn/svbrdf_gcn.h" | tr -d '(' | sort -u >"$out/declared"
    diff "$out/declared" "$out/exported"
}

soname() {
    local name
    name=$(readelf -d "$prefix/lib/libsvbrdf_gcn.so" | sed -n 's/.*SONAME.*\[\(.*\)\]/\1/p')
    [ "$name" = "libsvbrdf_gcn.so.${version%%.*}" ] && [ -e "$prefix/lib/$name" ] && [ "$(pkg-config --modversion svbrdf_gcn)" = "$version" ]
}

# The example, built by pkg-config against the static library: it must not need the shared one.
static_consumer() {
    local lib
    lib=$(pkg-config --variable=libdir svbrdf_gcn)/libsvbrdf_gcn.a
    c99 examples/fit_material.c "$lib" $(pkg-config --static --libs-only-l svbrdf_gcn | sed 's/-lsvbrdf_gcn//') -o "$out/fit_static"
    ldd "$out/fit_static" | grep svbrdf_gcn && return 1
    "$out/fit_static" "$small" "$out/static"
}

shared_consumer() {
    c99 examples/fit_material.c $libs -o "$out/fit_shared"
    ldd "$out/fit_shared" | grep "libsvbrdf_gcn.so.${version%%.*} => $prefix/lib/"
    "$out/fit_shared" "$small" "$out/shared"
    cmp "$out/static/diffuse.exr" "$out/shared/diffuse.exr"
}

cmake_consumer() {
    cmake -S tests/consumer -B "$out/cmake" -DCMAKE_PREFIX_PATH="$prefix" -DWANTED_VERSION="$version" &&
        cmake --build "$out/cmake"
    "$out/cmake/fit_c" "$small" "$out/cmake-c"
    "$out/cmake/fit_cpp" "$small" "$out/cmake-cpp"
    cmp "$out/cmake-c/diffuse.exr" "$out/cmake-cpp/diffuse.exr"
}

cmake_refuses_newer() {
    ! cmake -S tests/consumer -B "$out/cmake-newer" -DCMAKE_PREFIX_PATH="$prefix" -DWANTED_VERSION=99.0 2>"$out/cmake-error"
    grep "version: $version" "$out/cmake-error"
}

# Photos through OpenImageIO, maps through OpenImageIO, and the maps are those that we read back ourselves.
oiio_example() {
    cmake -S examples/oiio -B "$out/oiio" -DCMAKE_PREFIX_PATH="$prefix" -DCMAKE_CXX_FLAGS="-Wall -Wextra" &&
        cmake --build "$out/oiio"
    mkdir -p "$out/oiio-maps"
    python3 - >"$out/photos.txt" <<'PY'
import json
for photo in json.load(open("samples/lambert/capture.json"))["photos"]:
    print("samples/lambert/" + photo["file"], *photo["camera"], *photo.get("light", photo["camera"]))
PY
    "$out/oiio/fit_photos" "$out/oiio-maps" tif 10 600 32 <"$out/photos.txt"
    for map in diffuse specular roughness normal; do
        [ -s "$out/oiio-maps/$map.tif" ]
    done
    "$out/oiio/fit_photos" "$out/oiio-maps" tif 10 600 32 </dev/null && return 1
    return 0
}

# `make golden` runs them and compares what they write.
golden_programs() {
    c99 tests/golden/fit.c $libs -o "$out/golden-c"
    cpp17 tests/golden/fit.cpp $libs -o "$out/golden-cpp"
}

# Does a program with this flag really find what it is for?
sanitizer_works() {
    printf 'int main(int c, char **v) { (void)v; int a[2] = {0, 0}; return a[c + 1]; }\n' >"$out/bad.c"
    $CC $sanitize "$out/bad.c" -o "$out/bad" && ! "$out/bad"
}

valgrind_run() {
    valgrind --quiet --error-exitcode=9 --leak-check=full --show-leak-kinds=definite --errors-for-leak-kinds=definite "$@"
}

# Both at once: valgrind runs one thread at a time.
both_under_valgrind() {
    local c cpp=0
    valgrind_run "$out/test_c" samples "$out/c-valgrind" quick &
    c=$!
    valgrind_run "$out/test_cpp" samples quick || cpp=$?
    wait "$c" && [ "$cpp" = 0 ]
}

# A capture of four photos that the consumers fit quickly.
small=$out/small
mkdir -p "$small"
python3 - "$small" <<'PY'
import json, pathlib, sys
source = pathlib.Path("samples/lambert").resolve()
capture = json.loads((source / "capture.json").read_text())
capture["photos"] = [dict(photo, file=photo["file"]) for photo in capture["photos"][:2]]
for photo in capture["photos"]:
    (pathlib.Path(sys.argv[1]) / photo["file"]).write_bytes((source / photo["file"]).read_bytes())
(pathlib.Path(sys.argv[1]) / "capture.json").write_text(json.dumps(capture))
PY

if [ -z "${ASAN:-}" ]; then
    step "headers compile as C99 and C++17" headers_compile
    step "exported symbols" symbols
    step "soname and version" soname
    step "C99 program" c99 tests/c/test_api.c $libs -o "$out/test_c"
    step "C++17 program" cpp17 tests/cpp/test_api.cpp $libs -o "$out/test_cpp"
    step "static consumer by pkg-config" static_consumer
    step "shared consumer by pkg-config" shared_consumer
    step "consumer by CMake" cmake_consumer
    step "CMake refuses a newer version" cmake_refuses_newer
    step "program of the README" readme_program
    step "OpenImageIO example" oiio_example
    step "programs of one capture in C and C++" golden_programs
    step "C and C++ tests under valgrind" both_under_valgrind
fi
step "the sanitizer finds an overflow" sanitizer_works
step "C99 program, sanitized" c99 $sanitize tests/c/test_api.c $libs -o "$out/test_c_sanitized"
step "C99 tests, sanitized" "$out/test_c_sanitized" samples "$out/c-sanitized" ${ASAN:+quick}
step "C++17 program, sanitized" cpp17 $sanitize tests/cpp/test_api.cpp $libs -o "$out/test_cpp_sanitized"
step "C++17 tests, sanitized" "$out/test_cpp_sanitized" samples ${ASAN:+quick}

echo "C and C++: $passed passed, $failed failed"
[ "$failed" = 0 ]
