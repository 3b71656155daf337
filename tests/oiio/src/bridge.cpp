#include "svbrdf-gcn-oiio-tests/src/bridge.h"

#include <OpenImageIO/color.h>
#include <OpenImageIO/imagebuf.h>
#include <OpenImageIO/imagebufalgo.h>
#include <OpenImageIO/imageio.h>

#include <stdexcept>
#include <string>
#include <vector>

#include "svbrdf-gcn-oiio-tests/src/lib.rs.h"

namespace svbrdf_gcn_oiio {

namespace {

[[noreturn]] void fail(const std::string &what, const std::string &error) {
    throw std::runtime_error(what + ": " + error);
}

OIIO::ImageSpec spec_of(const Picture &picture, OIIO::TypeDesc type) {
    std::vector<std::string> names;
    for (const auto &name : OIIO::Strutil::splitsv(std::string(picture.channels), ",")) {
        names.emplace_back(name);
    }
    OIIO::ImageSpec spec(picture.width, picture.height, static_cast<int>(names.size()), type);
    spec.channelnames = names;
    spec.alpha_channel = -1;
    for (int c = 0; c < spec.nchannels; ++c) {
        if (names[c] == "A") spec.alpha_channel = c;
    }
    spec.x = picture.x;
    spec.y = picture.y;
    const bool full = picture.full_width > 0;
    spec.full_x = full ? picture.full_x : picture.x;
    spec.full_y = full ? picture.full_y : picture.y;
    spec.full_width = full ? picture.full_width : picture.width;
    spec.full_height = full ? picture.full_height : picture.height;
    return spec;
}

}  // namespace

Picture read(rust::Str path) {
    const std::string name(path);
    OIIO::ImageSpec config;
    config["oiio:UnassociatedAlpha"] = 1;
    auto input = OIIO::ImageInput::open(name, &config);
    if (!input) fail(name, OIIO::geterror());
    const OIIO::ImageSpec spec = input->spec();
    std::vector<float> values(spec.image_pixels() * spec.nchannels);
    if (!input->read_image(0, 0, 0, spec.nchannels, OIIO::TypeFloat, values.data())) fail(name, input->geterror());
    Picture picture;
    picture.width = spec.width;
    picture.height = spec.height;
    picture.x = spec.x;
    picture.y = spec.y;
    picture.full_x = spec.full_x;
    picture.full_y = spec.full_y;
    picture.full_width = spec.full_width;
    picture.full_height = spec.full_height;
    picture.channels = OIIO::Strutil::join(spec.channelnames, ",");
    picture.values.reserve(values.size());
    for (float value : values) picture.values.push_back(value);
    return picture;
}

void write(rust::Str path, const Picture &picture, const Encoding &encoding) {
    const std::string name(path);
    OIIO::attribute("tiff:half", 1);
    auto output = OIIO::ImageOutput::create(name);
    if (!output) fail(name, OIIO::geterror());
    OIIO::ImageSpec spec = spec_of(picture, OIIO::TypeDesc(std::string(encoding.format)));
    spec["oiio:UnassociatedAlpha"] = 1;
    if (!encoding.compression.empty()) spec["compression"] = std::string(encoding.compression);
    if (encoding.separate) spec["planarconfig"] = "separate";
    if (encoding.orientation > 0) spec["Orientation"] = encoding.orientation;
    if (encoding.tile > 0) spec.tile_width = spec.tile_height = encoding.tile;
    const int parts = encoding.parts > 0 ? encoding.parts : 1;
    std::vector<OIIO::ImageSpec> specs(parts, spec);
    for (int part = 0; part < parts; ++part) {
        if (parts > 1) specs[part]["oiio:subimagename"] = "part" + std::to_string(part);
    }
    for (int part = 0; part < parts; ++part) {
        const bool open = part == 0 ? (parts > 1 ? output->open(name, parts, specs.data()) : output->open(name, spec))
                                    : output->open(name, specs[part], OIIO::ImageOutput::AppendSubimage);
        if (!open || !output->write_image(OIIO::TypeFloat, picture.values.data())) fail(name, output->geterror());
    }
    if (!output->close()) fail(name, output->geterror());
}

Picture convert(rust::Str config, rust::Str from, rust::Str to, const Picture &picture) {
    OIIO::ColorConfig colors{std::string(config)};
    if (colors.error()) fail(std::string(config), colors.geterror());
    Picture converted = picture;
    OIIO::ImageBuf buffer(spec_of(picture, OIIO::TypeFloat), converted.values.data());
    if (!OIIO::ImageBufAlgo::colorconvert(buffer, buffer, std::string(from), std::string(to), false, "", "", &colors)) {
        fail(std::string(from) + " to " + std::string(to), buffer.geterror());
    }
    return converted;
}

}  // namespace svbrdf_gcn_oiio
