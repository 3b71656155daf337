// The fit of compare.py in C++: fit CAPTURE OUT FORMAT
#include <iostream>
#include <map>
#include <string>

#include <svbrdf_gcn/svbrdf_gcn.hpp>

using namespace svbrdf_gcn;

int main(int argc, char **argv) try {
    if (argc != 4) {
        return 2;
    }
    CaptureOptions capture_options;
    capture_options.size = 48;
    capture_options.views = {6, 0, 2, 4};
    Options options;
    options.preset = Preset::Draft;
    options.seed = 7;
    options.threads = 2;
    const std::map<std::string, Format> formats{{"exr", Format::Exr}, {"png16", Format::Png16}, {"tiff", Format::Tiff}};
    fit_material(Capture::open(argv[1], capture_options), options).save(argv[2], formats.at(argv[3]));
} catch (const std::exception &error) {
    std::cerr << error.what() << '\n';
    return 1;
}
