#pragma once

#include "rust/cxx.h"

namespace svbrdf_gcn_oiio {

struct Picture;
struct Encoding;

Picture read(rust::Str path);
void write(rust::Str path, const Picture &picture, const Encoding &encoding);
Picture convert(rust::Str config, rust::Str from, rust::Str to, const Picture &picture);

}  // namespace svbrdf_gcn_oiio
