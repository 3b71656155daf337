// Fits a material to a capture on disk and writes its maps: fit_material CAPTURE OUT
#include <iostream>

#include <svbrdf_gcn/svbrdf_gcn.hpp>

int main(int argc, char **argv) try {
    if (argc != 3) {
        std::cerr << "usage: " << argv[0] << " CAPTURE OUT\n";
        return 2;
    }
    const auto capture = svbrdf_gcn::Capture::open(argv[1]);
    svbrdf_gcn::Options options;
    options.preset = svbrdf_gcn::Preset::Draft;
    const auto material = svbrdf_gcn::fit_material(capture, options, [](const svbrdf_gcn::Progress &progress) {
        std::cerr << '\r' << progress.step << " of " << progress.steps << " steps, loss " << progress.loss.value_or(0) << ' ';
        return svbrdf_gcn::Step::Continue;
    });
    material.save(argv[2]);
    for (std::size_t i = 0; i < capture.size(); ++i) {
        std::cout << "photo " << i << ": RMSE " << material.photo_rmse(capture, i) << '\n';
    }
} catch (const svbrdf_gcn::Error &error) {
    std::cerr << error.what() << '\n';
    return 1;
}
