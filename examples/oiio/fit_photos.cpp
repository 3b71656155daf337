// Photos in any format that OpenImageIO reads, maps in any that it writes:
//
//     fit_photos OUT EXTENSION PATCH_SIZE INTENSITY [SIZE] < PHOTOS
//
// Each line of PHOTOS is a file and where camera and light stood: FILE CAMERA_X Y Z LIGHT_X Y Z. 8-bit photos are taken as sRGB, others as linear.
// INTENSITY is that of the light (see docs/captures.md), SIZE the longer side of the maps in pixels. The maps are written to OUT as linear floats, normals as
// (n + 1) / 2.
#include <cstdint>
#include <iostream>
#include <optional>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include <OpenImageIO/imagebuf.h>

#include <svbrdf_gcn/svbrdf_gcn.hpp>

namespace {

/// The first three channels of a file, in memory as type `Value`; grey ones stay one.
template <class Value> std::vector<Value> pixels(const OIIO::ImageBuf &image, int channels) {
    auto roi = image.roi_full();
    roi.chend = channels;
    std::vector<Value> values(static_cast<std::size_t>(roi.npixels()) * static_cast<std::size_t>(channels));
    if (!image.get_pixels(roi, OIIO::BaseTypeFromC<Value>::value, values.data())) {
        throw std::runtime_error(image.geterror());
    }
    return values;
}

/// Adds a photo; the capture has to be made for photos of its kind.
void add(svbrdf_gcn::Capture &capture, const OIIO::ImageBuf &image, const svbrdf_gcn::Shot &shot, bool is_8_bit) {
    const int channels = image.nchannels() < 3 ? 1 : 3;
    const auto full = image.roi_full();
    const auto width = static_cast<std::size_t>(full.width()), height = static_cast<std::size_t>(full.height());
    if (is_8_bit) {
        const auto values = pixels<std::uint8_t>(image, channels);
        capture.add_photo({values.data(), width, height, channels}, shot);
    } else {
        const auto values = pixels<float>(image, channels);
        capture.add_photo({values.data(), width, height, channels}, shot);
    }
}

void write(const std::string &path, const svbrdf_gcn::MapView &map, bool is_vector) {
    OIIO::ImageSpec spec(static_cast<int>(map.width), static_cast<int>(map.height), map.channels, OIIO::TypeFloat);
    spec.attribute("oiio:ColorSpace", is_vector || map.channels == 1 ? "Raw" : "Linear");
    OIIO::ImageBuf image(spec);
    std::vector<float> values(map.begin(), map.end());
    if (is_vector) {
        for (auto &value : values) {
            value = (value + 1) / 2;
        }
    }
    if (!image.set_pixels(image.roi(), OIIO::TypeFloat, values.data()) || !image.write(path)) {
        throw std::runtime_error(path + ": " + image.geterror());
    }
    std::cout << path << '\n';
}

} // namespace

int main(int argc, char **argv) try {
    if (argc < 5) {
        std::cerr << "usage: " << argv[0] << " OUT EXTENSION PATCH_SIZE INTENSITY [SIZE] < PHOTOS\n";
        return 2;
    }
    const std::string out = argv[1], extension = argv[2];
    const double patch_size = std::stod(argv[3]), intensity = std::stod(argv[4]);

    // Alpha is not to be multiplied into colours that are no colours of a picture.
    OIIO::ImageSpec unassociated;
    unassociated.attribute("oiio:UnassociatedAlpha", 1);

    std::optional<svbrdf_gcn::Capture> capture;
    bool is_8_bit = false;
    for (std::string line; std::getline(std::cin, line);) {
        std::istringstream fields(line);
        svbrdf_gcn::Shot shot;
        shot.light_intensity = {intensity, intensity, intensity};
        std::string file;
        fields >> file >> shot.camera[0] >> shot.camera[1] >> shot.camera[2] >> shot.light[0] >> shot.light[1] >> shot.light[2];
        if (!fields) {
            throw std::runtime_error("expected FILE and six numbers, got \"" + line + '"');
        }
        shot.name = file;
        OIIO::ImageBuf image(file, 0, 0, nullptr, &unassociated);
        if (!image.read()) {
            throw std::runtime_error(file + ": " + image.geterror());
        }
        if (!capture) {
            is_8_bit = image.nativespec().format == OIIO::TypeUInt8;
            svbrdf_gcn::CaptureOptions options;
            options.transfer = is_8_bit ? svbrdf_gcn::Transfer::Srgb : svbrdf_gcn::Transfer::Linear;
            if (argc > 5) {
                options.size = std::stol(argv[5]);
            }
            capture.emplace(patch_size, options);
        }
        add(*capture, image, shot, is_8_bit);
    }
    if (!capture) {
        throw std::runtime_error("expected photos on standard input, got none");
    }

    svbrdf_gcn::Options options;
    options.preset = svbrdf_gcn::Preset::Draft;
    const auto material = svbrdf_gcn::fit_material(*capture, options);
    for (const auto &warning : material.warnings()) {
        std::cerr << "warning: " << warning << '\n';
    }
    write(out + "/diffuse." + extension, material.diffuse_albedo(), false);
    write(out + "/specular." + extension, material.specular_albedo(), false);
    write(out + "/roughness." + extension, material.roughness(), false);
    write(out + "/normal." + extension, material.normal(), true);
} catch (const std::exception &error) {
    std::cerr << error.what() << '\n';
    return 1;
}
