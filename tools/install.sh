#!/usr/bin/env bash
# Installs libraries, headers, and what pkg-config and CMake need: install.sh BUILT PREFIX, where BUILT holds the libraries as Cargo made them.
set -euo pipefail
cd "$(dirname "$0")/.."
built=$1
prefix=$2

version=$(sed -n 's/^version = "\(.*\)"$/\1/p' Cargo.toml | head -n 1)
IFS=. read -r major minor _ <<<"$version"

fill() {
    install -d "$(dirname "$2")"
    sed "s/@VERSION@/$version/g; s/@MAJOR@/$major/g; s/@MINOR@/$minor/g" "$1" >"$2"
    chmod 644 "$2"
}

install -D -m 644 -t "$prefix/include/svbrdf_gcn" include/svbrdf_gcn/svbrdf_gcn.h include/svbrdf_gcn/svbrdf_gcn.hpp
install -D -m 644 "$built/libsvbrdf_gcn_ffi.a" "$prefix/lib/libsvbrdf_gcn.a"
install -D -m 755 "$built/libsvbrdf_gcn_ffi.so" "$prefix/lib/libsvbrdf_gcn.so.$version"
ln -sf "libsvbrdf_gcn.so.$version" "$prefix/lib/libsvbrdf_gcn.so.$major"
ln -sf "libsvbrdf_gcn.so.$major" "$prefix/lib/libsvbrdf_gcn.so"
fill ffi/svbrdf_gcn.pc.in "$prefix/lib/pkgconfig/svbrdf_gcn.pc"
for file in svbrdf_gcnConfig.cmake svbrdf_gcnConfigVersion.cmake; do
    fill "ffi/cmake/$file.in" "$prefix/lib/cmake/svbrdf_gcn/$file"
done
