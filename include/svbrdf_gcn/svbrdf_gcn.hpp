// svbrdf-gcn for C++17: material maps from flash photos. Header-only, over svbrdf_gcn.h; link the library of that header.
//
// Classes own their handle and can be moved, not copied. What fails throws svbrdf_gcn::Error; an exception thrown by a progress callback stops the fit
// and comes out of it as it is. Views (MapView, ImageView) borrow: the pixels belong to whom they came from.
#ifndef SVBRDF_GCN_HPP
#define SVBRDF_GCN_HPP

#include <array>
#include <cstddef>
#include <cstdint>
#include <exception>
#include <functional>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include <svbrdf_gcn/svbrdf_gcn.h>

namespace svbrdf_gcn {

/// What any call may throw.
class Error : public std::runtime_error {
public:
    Error(svbrdf_gcn_status code, const std::string &message) : std::runtime_error(message), code_(code) {}

    /// The status the C function returned; SVBRDF_GCN_CANCELLED where somebody asked to stop.
    svbrdf_gcn_status code() const noexcept { return code_; }

private:
    svbrdf_gcn_status code_;
};

namespace detail {

inline void check(svbrdf_gcn_status status) {
    if (status != SVBRDF_GCN_OK) {
        throw Error(status, svbrdf_gcn_last_error_message());
    }
}

/// Ends a handle by the function of its type.
template <auto destroy> struct Deleter {
    template <class Handle> void operator()(Handle *handle) const noexcept { destroy(handle); }
};

template <class Handle, auto destroy> using Owner = std::unique_ptr<Handle, Deleter<destroy>>;

/// The handle that `make` leaves in its argument.
template <class Handle, class Make> Handle *made(Make &&make) {
    Handle *handle = nullptr;
    check(make(&handle));
    return handle;
}

/// A struct with its defaults.
template <class Struct> Struct initialised(svbrdf_gcn_status (*init)(Struct *, std::size_t)) {
    Struct value;
    check(init(&value, sizeof value));
    return value;
}

template <class Handle> std::vector<std::string> strings(const char *(*at)(const Handle *, std::size_t), const Handle *handle) {
    std::vector<std::string> found;
    while (const char *text = at(handle, found.size())) {
        found.emplace_back(text);
    }
    return found;
}

} // namespace detail

/// Throws if the library that is loaded has another interface than this header.
inline void check_abi() {
    if (svbrdf_gcn_abi_version() != SVBRDF_GCN_ABI_VERSION) {
        throw Error(SVBRDF_GCN_ERR_INVALID_ARGUMENT,
                    "the library has interface " + std::to_string(svbrdf_gcn_abi_version()) + ", the program was compiled for " +
                        std::to_string(SVBRDF_GCN_ABI_VERSION));
    }
}

enum class Preset : std::int32_t {
    Draft = SVBRDF_GCN_PRESET_DRAFT,
    Balanced = SVBRDF_GCN_PRESET_BALANCED,
    High = SVBRDF_GCN_PRESET_HIGH,
};

enum class Method : std::int32_t {
    Auto = SVBRDF_GCN_METHOD_AUTO,
    Network = SVBRDF_GCN_METHOD_NETWORK,
    Direct = SVBRDF_GCN_METHOD_DIRECT,
};

/// What a surface is taken to be made of.
enum class Reflectance : std::int32_t {
    Auto = SVBRDF_GCN_REFLECTANCE_AUTO,
    Diffuse = SVBRDF_GCN_REFLECTANCE_DIFFUSE,
    Dielectric = SVBRDF_GCN_REFLECTANCE_DIELECTRIC,
    Isotropic = SVBRDF_GCN_REFLECTANCE_ISOTROPIC,
    Anisotropic = SVBRDF_GCN_REFLECTANCE_ANISOTROPIC,
};

/// What of the capture's own statements a fit may correct.
enum class Refine : std::int32_t {
    Auto = SVBRDF_GCN_REFINE_AUTO,
    None = SVBRDF_GCN_REFINE_NONE,
    Light = SVBRDF_GCN_REFINE_LIGHT,
    All = SVBRDF_GCN_REFINE_ALL,
};

enum class Transfer : std::int32_t {
    FromCapture = SVBRDF_GCN_TRANSFER_FROM_CAPTURE,
    Gamma22 = SVBRDF_GCN_TRANSFER_GAMMA22,
    Srgb = SVBRDF_GCN_TRANSFER_SRGB,
    Linear = SVBRDF_GCN_TRANSFER_LINEAR,
};

enum class ColorSpace : std::int32_t {
    FromCapture = SVBRDF_GCN_COLOR_SPACE_FROM_CAPTURE,
    Rec709 = SVBRDF_GCN_COLOR_SPACE_REC709,
    AcesCg = SVBRDF_GCN_COLOR_SPACE_ACESCG,
};

enum class ExportTarget : std::int32_t {
    MaterialX = SVBRDF_GCN_EXPORT_MATERIALX,
    Gltf = SVBRDF_GCN_EXPORT_GLTF,
    Principled = SVBRDF_GCN_EXPORT_PRINCIPLED,
    Unreal = SVBRDF_GCN_EXPORT_UNREAL,
};

enum class Normals : std::int32_t {
    OfTarget = SVBRDF_GCN_NORMALS_OF_TARGET,
    OpenGl = SVBRDF_GCN_NORMALS_OPENGL,
    DirectX = SVBRDF_GCN_NORMALS_DIRECTX,
};

enum class Format : std::int32_t {
    Exr = SVBRDF_GCN_FORMAT_EXR,
    Png16 = SVBRDF_GCN_FORMAT_PNG16,
    Tiff = SVBRDF_GCN_FORMAT_TIFF,
};

enum class Verdict : std::int32_t {
    None = SVBRDF_GCN_VERDICT_NONE,
    Good = SVBRDF_GCN_VERDICT_GOOD,
    Usable = SVBRDF_GCN_VERDICT_USABLE,
    Poor = SVBRDF_GCN_VERDICT_POOR,
};

enum class Map : std::int32_t {
    DiffuseAlbedo = SVBRDF_GCN_MAP_DIFFUSE_ALBEDO,
    SpecularAlbedo = SVBRDF_GCN_MAP_SPECULAR_ALBEDO,
    Roughness = SVBRDF_GCN_MAP_ROUGHNESS,
    Normal = SVBRDF_GCN_MAP_NORMAL,
    Tangent = SVBRDF_GCN_MAP_TANGENT,
    DiffuseAlbedoDeviation = SVBRDF_GCN_MAP_DIFFUSE_ALBEDO_DEVIATION,
    SpecularAlbedoDeviation = SVBRDF_GCN_MAP_SPECULAR_ALBEDO_DEVIATION,
    RoughnessDeviation = SVBRDF_GCN_MAP_ROUGHNESS_DEVIATION,
    NormalDeviation = SVBRDF_GCN_MAP_NORMAL_DEVIATION,
};

enum class Stage : std::int32_t {
    Other = SVBRDF_GCN_STAGE_OTHER,
    Encode = SVBRDF_GCN_STAGE_ENCODE,
    Latent = SVBRDF_GCN_STAGE_LATENT,
    Adapters = SVBRDF_GCN_STAGE_ADAPTERS,
    Direct = SVBRDF_GCN_STAGE_DIRECT,
    Finish = SVBRDF_GCN_STAGE_FINISH,
    Acquire = SVBRDF_GCN_STAGE_ACQUIRE,
};

enum class PixelType : std::int32_t {
    Uint8 = SVBRDF_GCN_PIXEL_UINT8,
    Uint16 = SVBRDF_GCN_PIXEL_UINT16,
    Half = SVBRDF_GCN_PIXEL_HALF,
    Float = SVBRDF_GCN_PIXEL_FLOAT,
};

/// What a progress callback returns.
enum class Step : std::int32_t { Continue = SVBRDF_GCN_CONTINUE, Stop = SVBRDF_GCN_STOP };

/// Where a fit, or acquire, stands.
struct Progress {
    Stage stage;
    /// Steps of this stage that are done, and that it takes at most.
    std::size_t step, steps;
    /// The loss before the last step.
    std::optional<double> loss;
};

/// Called on the thread that called fit_material, after every step and some ten times a second in long ones, or acquire, some twenty times a second.
using ProgressFunction = std::function<Step(const Progress &)>;

/// Stops fits, acquire and the reading of photos from any thread. Once cancelled it stays cancelled.
class CancelToken {
public:
    CancelToken() : handle_(detail::made<svbrdf_gcn_cancel_token>(svbrdf_gcn_cancel_token_create)) {}

    void cancel() const { detail::check(svbrdf_gcn_cancel_token_cancel(handle_.get())); }
    bool is_cancelled() const noexcept { return svbrdf_gcn_cancel_token_is_cancelled(handle_.get()) != 0; }
    const svbrdf_gcn_cancel_token *get() const noexcept { return handle_.get(); }

private:
    detail::Owner<svbrdf_gcn_cancel_token, svbrdf_gcn_cancel_token_destroy> handle_;
};

using Vec3 = std::array<double, 3>;

/// Where camera and light stood: the sample is centred at the origin in the plane z = 0, x right, y up, z towards the camera.
struct Shot {
    Vec3 camera{}, light{}, light_intensity{};
    /// What messages call the photo; may be empty.
    std::string name;
};

/// Pixels of the host. Strides are in bytes and may be negative, 0 stands for packed; `data` is the top left pixel.
struct ImageView {
    const void *data = nullptr;
    PixelType type = PixelType::Float;
    std::size_t width = 0, height = 0;
    int channels = 3;
    std::ptrdiff_t row_stride = 0, pixel_stride = 0, channel_stride = 0;

    ImageView() = default;

    /// Pixels of a type that the pointer tells: uint8_t, uint16_t or float. (For half floats set `type` by hand.)
    template <class Value>
    ImageView(const Value *pixels, std::size_t columns, std::size_t rows, int values_per_pixel = 3)
        : data(pixels), type(type_of<Value>()), width(columns), height(rows), channels(values_per_pixel) {}

private:
    template <class Value> static constexpr PixelType type_of() {
        static_assert(std::is_same_v<Value, std::uint8_t> || std::is_same_v<Value, std::uint16_t> || std::is_same_v<Value, float>,
                      "expected uint8_t, uint16_t or float");
        return std::is_same_v<Value, std::uint8_t>    ? PixelType::Uint8
               : std::is_same_v<Value, std::uint16_t> ? PixelType::Uint16
                                                      : PixelType::Float;
    }
};

/// Floats lent by a material or a capture: packed rows from the top.
struct MapView {
    const float *data = nullptr;
    std::size_t width = 0, height = 0;
    int channels = 0;

    float at(std::size_t row, std::size_t column, int channel) const noexcept {
        return data[(row * width + column) * static_cast<std::size_t>(channels) + static_cast<std::size_t>(channel)];
    }
    std::size_t size() const noexcept { return width * height * static_cast<std::size_t>(channels); }
    const float *begin() const noexcept { return data; }
    const float *end() const noexcept { return data + size(); }
};

/// An image that owns its pixels: packed floats, rows from the top.
struct Image {
    std::vector<float> data;
    std::size_t width = 0, height = 0;
    int channels = 3;

    operator MapView() const noexcept { return {data.data(), width, height, channels}; }
    operator ImageView() const noexcept { return {data.data(), width, height, channels}; }
};

/// How photos are read.
struct CaptureOptions {
    /// Photos whose longer side is above this are resampled by area, and so are the maps.
    std::optional<std::int64_t> size;
    /// Only these photos of a capture on disk, counted from 0, in this order.
    std::optional<std::vector<std::size_t>> views;
    /// How stored values relate to linear radiance; pixels of the host need it stated.
    Transfer transfer = Transfer::FromCapture;
    /// The stored value at which float pixels of the host are saturated.
    std::optional<float> white_level;
    /// Primaries of linear photos and of their light; what a capture on disk states, or Rec. 709, if not given.
    ColorSpace color_space = ColorSpace::FromCapture;
    /// Read photos on disk as if their files held no colour profiles.
    bool ignore_profiles = false;
    /// Stops the reading from another thread; has to live until the photos are read.
    const CancelToken *cancel = nullptr;
    /// Most bytes the run may use, from the reading of photos on; three quarters of the free memory if not given.
    std::optional<std::int64_t> max_memory;
    /// Intensity of the light of every photo, in place of what the capture on disk states, or of what is chosen for one photo alone.
    std::optional<Vec3> light_intensity;
};

/// How photos of a printed sheet, or photos of which the patch's corners are known, become a capture; lengths are in millimetres.
struct AcquireOptions {
    /// Width of the window of our own sheet.
    double window = 100.0;
    /// The photos show the frame of svbrdf-diff-renderer instead, this wide from outer edge to outer edge.
    std::optional<double> frame_width;
    /// Length of the sheet's bar of 100 mm as it was printed.
    double printed_bar = 100.0;
    /// How far the sample lies below the sheet's face.
    double depth = 0.0;
    /// Where the flash is, seen from the lens: to the right and up in photos as they were taken, before they were turned upright.
    std::array<double, 2> light_offset{};
    /// Where the flash is is found from the paper.
    bool find_light_offset = false;
    /// Path of a photo of the sheet without flash, exposed as the others: what it shows is subtracted.
    std::string dark_photo;
    /// Diffuse albedo of the paper.
    double paper_white = 0.8;
    /// Side of the rectified photos in pixels; 1024 if not given. They are never finer than the photos.
    std::optional<std::int64_t> size;
    /// Most bytes the work may use; three quarters of the free memory if not given.
    std::optional<std::int64_t> max_memory;
    /// Stops the work from another thread; has to live until the call returns.
    const CancelToken *cancel = nullptr;
    /// There is no sheet: for each photo the corners of the sample's square patch, x, y in pixels of the photo as viewers show it, from the upper left on clockwise.
    /// What is said of a sheet does not count beside them.
    std::vector<std::array<double, 8>> corners;
    /// Width of the patch whose corners are given.
    double patch_width = 0.0;
};

/// Options of a fit, under the names of the command line.
struct Options {
    Preset preset = Preset::Balanced;
    Method method = Method::Auto;
    /// What the surface is taken to be made of; a network of the paper's form takes auto alone.
    Reflectance reflectance = Reflectance::Auto;
    /// What of the capture's statements may be corrected.
    Refine refine = Refine::Auto;
    /// Path of other weights than those built in, for those who load no Model.
    std::string weights;
    /// Steps of the stages, instead of the preset's.
    std::optional<std::int64_t> latent_steps, adapter_steps, direct_steps, finish_steps;
    /// Most bytes the run may use, photos and weights included; three quarters of the free memory beside these if not given.
    std::optional<std::int64_t> max_memory;
    std::uint64_t seed = 0;
    /// All the machine offers if not given.
    std::optional<std::int32_t> threads;
    bool early_stop = true;
    /// Stops the run from another thread; has to live until the fit returns.
    const CancelToken *cancel = nullptr;
};

namespace detail {

inline svbrdf_gcn_image_view view_of(const ImageView &image) {
    auto view = initialised(svbrdf_gcn_image_view_init);
    view.data = image.data;
    view.pixel_type = static_cast<std::int32_t>(image.type);
    view.channels = image.channels;
    view.width = image.width;
    view.height = image.height;
    view.row_stride = image.row_stride;
    view.pixel_stride = image.pixel_stride;
    view.channel_stride = image.channel_stride;
    return view;
}

inline MapView map_view(const svbrdf_gcn_image_view &view) {
    return {static_cast<const float *>(view.data), view.width, view.height, view.channels};
}

/// The shot for C; it borrows the name.
inline svbrdf_gcn_shot shot_of(const Shot &shot) {
    auto made = initialised(svbrdf_gcn_shot_init);
    made.name = shot.name.empty() ? nullptr : shot.name.c_str();
    for (std::size_t i = 0; i < 3; ++i) {
        made.camera[i] = shot.camera[i];
        made.light[i] = shot.light[i];
        made.light_intensity[i] = shot.light_intensity[i];
    }
    return made;
}

/// The options for C; they borrow the views.
inline svbrdf_gcn_capture_options capture_options(const CaptureOptions &options) {
    auto made = initialised(svbrdf_gcn_capture_options_init);
    made.size = options.size.value_or(-1);
    if (options.views) {
        static constexpr std::size_t none = 0;
        made.views = options.views->empty() ? &none : options.views->data();
        made.view_count = options.views->size();
    }
    made.transfer = static_cast<std::int32_t>(options.transfer);
    made.white_level = options.white_level.value_or(0.0f);
    made.color_space = static_cast<std::int32_t>(options.color_space);
    made.ignore_profiles = options.ignore_profiles ? 1 : 0;
    made.cancel = options.cancel ? options.cancel->get() : nullptr;
    made.max_memory = options.max_memory.value_or(-1);
    if (options.light_intensity) {
        for (std::size_t i = 0; i < 3; ++i) {
            made.light_intensity[i] = (*options.light_intensity)[i];
        }
    }
    return made;
}

/// What the trampoline needs of the caller.
struct Caller {
    const ProgressFunction &progress;
    std::exception_ptr thrown;
};

/// Calls the callback; what it throws is kept and stops the fit.
inline std::int32_t trampoline(void *user_data, const svbrdf_gcn_progress *at) noexcept {
    auto &caller = *static_cast<Caller *>(user_data);
    try {
        const Progress progress{static_cast<Stage>(at->stage), at->step, at->steps,
                                at->has_loss ? std::optional<double>(at->loss) : std::nullopt};
        return static_cast<std::int32_t>(caller.progress(progress));
    } catch (...) {
        caller.thrown = std::current_exception();
        return SVBRDF_GCN_STOP;
    }
}

/// Calls the C function with options that report to `progress`; what that throws comes out.
template <class Handle, class Options, class Call> Handle *reported(Options options, const ProgressFunction &progress, Call &&call) {
    Caller caller{progress, nullptr};
    if (progress) {
        options.progress = trampoline;
        options.progress_user_data = &caller;
    }
    Handle *handle = nullptr;
    const auto status = call(&options, &handle);
    if (caller.thrown) {
        std::rethrow_exception(caller.thrown);
    }
    check(status);
    return handle;
}

} // namespace detail

struct Acquisition;

/// Photos of one sample, all of the same size, and where camera and light stood for each.
class Capture {
public:
    /// Reads a folder or a JSON file, as the command line does.
    static Capture open(const std::string &path, const CaptureOptions &options = {}) {
        const auto converted = detail::capture_options(options);
        return Capture(detail::made<svbrdf_gcn_capture>(
            [&](svbrdf_gcn_capture **out) { return svbrdf_gcn_capture_open(path.c_str(), &converted, out); }));
    }

    /// A capture for pixels of the host. `patch_size` is the width of the patch in the unit of the positions; `options` state the transfer function.
    Capture(double patch_size, const CaptureOptions &options)
        : Capture(detail::made<svbrdf_gcn_capture>([&](svbrdf_gcn_capture **out) {
              const auto converted = detail::capture_options(options);
              return svbrdf_gcn_capture_create(patch_size, &converted, out);
          })) {}

    /// Copies a photo.
    void add_photo(const ImageView &pixels, const Shot &shot) {
        const auto view = detail::view_of(pixels);
        const auto converted = detail::shot_of(shot);
        detail::check(svbrdf_gcn_capture_add_photo(handle_.get(), &view, &converted));
    }

    std::size_t size() const noexcept { return svbrdf_gcn_capture_photo_count(handle_.get()); }
    std::size_t width() const noexcept { return svbrdf_gcn_capture_width(handle_.get()); }
    std::size_t height() const noexcept { return svbrdf_gcn_capture_height(handle_.get()); }

    /// A photo as the fit sees it: linear RGB, lent by the capture until the next photo is added.
    MapView photo(std::size_t index) const {
        auto view = detail::initialised(svbrdf_gcn_image_view_init);
        detail::check(svbrdf_gcn_capture_photo(handle_.get(), index, &view));
        return detail::map_view(view);
    }

    Shot shot(std::size_t index) const {
        auto stored = detail::initialised(svbrdf_gcn_shot_init);
        detail::check(svbrdf_gcn_capture_shot(handle_.get(), index, &stored));
        Shot shot;
        for (std::size_t i = 0; i < 3; ++i) {
            shot.camera[i] = stored.camera[i];
            shot.light[i] = stored.light[i];
            shot.light_intensity[i] = stored.light_intensity[i];
        }
        return shot;
    }

    /// What a user should know about how the photos were read.
    std::vector<std::string> warnings() const {
        return detail::strings(svbrdf_gcn_capture_warning, handle_.get());
    }

    const svbrdf_gcn_capture *get() const noexcept { return handle_.get(); }

private:
    friend Acquisition acquire(const std::vector<std::string> &, const AcquireOptions &, const ProgressFunction &);
    explicit Capture(svbrdf_gcn_capture *handle) : handle_(handle) {}

    detail::Owner<svbrdf_gcn_capture, svbrdf_gcn_capture_destroy> handle_;
};

/// A capture made of raw photos, and how it came about.
struct Acquisition {
    /// The rectified photos with their positions, in millimetres. Its warnings are those of the report.
    Capture capture;
    /// What was found: photos, those left_out with the reason, lenses, warnings; assumptions where there was no sheet.
    std::string report_json;

    /// Writes capture.json, the rectified photos as OpenEXR, for each with saturated pixels a PNG that says which, and `contact-sheet.png`.
    void save(const std::string &folder) const { detail::check(svbrdf_gcn_capture_save(capture.get(), folder.c_str())); }
};

/// Makes a capture of photos that show the sample in the window of a printed sheet, or of which the patch's corners are known (docs/capturing.md). Photos that cannot be used are left out and named in the report.
inline Acquisition acquire(const std::vector<std::string> &photos, const AcquireOptions &options = {}, const ProgressFunction &progress = {}) {
    std::vector<const char *> paths;
    for (const auto &photo : photos) {
        paths.push_back(photo.c_str());
    }
    auto converted = detail::initialised(svbrdf_gcn_acquire_options_init);
    converted.window = options.window;
    converted.frame_width = options.frame_width.value_or(0.0);
    converted.printed_bar = options.printed_bar;
    converted.depth = options.depth;
    converted.light_offset[0] = options.light_offset[0];
    converted.light_offset[1] = options.light_offset[1];
    converted.find_light_offset = options.find_light_offset ? 1 : 0;
    converted.dark_photo_utf8 = options.dark_photo.empty() ? nullptr : options.dark_photo.c_str();
    converted.paper_white = options.paper_white;
    converted.size = options.size.value_or(-1);
    converted.max_memory = options.max_memory.value_or(-1);
    converted.cancel = options.cancel ? options.cancel->get() : nullptr;
    if (!options.corners.empty() && options.corners.size() != photos.size()) {
        throw Error(SVBRDF_GCN_ERR_INVALID_ARGUMENT, "corners: expected those of each of the " + std::to_string(photos.size()) + " photos, got those of " +
                                                         std::to_string(options.corners.size()));
    }
    converted.corners = options.corners.empty() ? nullptr : options.corners.front().data();
    converted.patch_width = options.patch_width;
    Capture capture(detail::reported<svbrdf_gcn_capture>(converted, progress, [&](const auto *how, svbrdf_gcn_capture **out) {
        return svbrdf_gcn_acquire(paths.data(), paths.size(), how, out);
    }));
    std::string report = svbrdf_gcn_capture_report_json(capture.get());
    return {std::move(capture), std::move(report)};
}

/// The maps of a material.
class Material {
public:
    /// Takes over a handle.
    explicit Material(svbrdf_gcn_material *handle) : handle_(handle) {}

    /// Reads a folder with a material.json.
    static Material load(const std::string &folder) {
        return Material(detail::made<svbrdf_gcn_material>(
            [&](svbrdf_gcn_material **out) { return svbrdf_gcn_material_load(folder.c_str(), out); }));
    }

    /// Writes the maps and material.json: the files that the command line writes.
    void save(const std::string &folder, Format format = Format::Exr, ColorSpace color_space = ColorSpace::Rec709) const {
        auto options = detail::initialised(svbrdf_gcn_save_options_init);
        options.format = static_cast<std::int32_t>(format);
        options.color_space = static_cast<std::int32_t>(color_space);
        detail::check(svbrdf_gcn_material_save(handle_.get(), folder.c_str(), &options));
    }

    /// Writes the material for another program. export.json in the folder says what every file holds and what was lost. `level`: without the tilt of the
    /// whole surface, so that tiles of it make a plane.
    void export_to(const std::string &folder, ExportTarget target, const std::string &name = "material", Normals normals = Normals::OfTarget,
                   bool level = true) const {
        auto options = detail::initialised(svbrdf_gcn_export_options_init);
        options.target = static_cast<std::int32_t>(target);
        options.name = name.c_str();
        options.normals = static_cast<std::int32_t>(normals);
        options.level = level ? 1 : 0;
        detail::check(svbrdf_gcn_material_export(handle_.get(), folder.c_str(), &options));
    }

    /// A map, lent by the material.
    MapView map(Map kind) const {
        auto view = detail::initialised(svbrdf_gcn_image_view_init);
        detail::check(svbrdf_gcn_material_map(handle_.get(), static_cast<std::int32_t>(kind), &view));
        return detail::map_view(view);
    }
    MapView diffuse_albedo() const { return map(Map::DiffuseAlbedo); }
    MapView specular_albedo() const { return map(Map::SpecularAlbedo); }
    MapView roughness() const { return map(Map::Roughness); }
    MapView normal() const { return map(Map::Normal); }
    MapView tangent() const { return map(Map::Tangent); }
    MapView diffuse_albedo_deviation() const { return map(Map::DiffuseAlbedoDeviation); }
    MapView specular_albedo_deviation() const { return map(Map::SpecularAlbedoDeviation); }
    MapView roughness_deviation() const { return map(Map::RoughnessDeviation); }
    MapView normal_deviation() const { return map(Map::NormalDeviation); }

    double patch_size() const noexcept { return svbrdf_gcn_material_patch_size(handle_.get()); }
    /// The unit of patch_size, where it is known.
    std::optional<std::string> unit() const {
        const char *name = svbrdf_gcn_material_unit(handle_.get());
        return name ? std::optional<std::string>(name) : std::nullopt;
    }

    /// A photo of the material, linear RGB.
    Image render(const Shot &shot) const {
        const auto size = normal();
        Image image{std::vector<float>(size.width * size.height * 3), size.width, size.height, 3};
        auto buffer = detail::initialised(svbrdf_gcn_image_buffer_init);
        buffer.data = image.data.data();
        buffer.pixel_type = SVBRDF_GCN_PIXEL_FLOAT;
        buffer.channels = image.channels;
        buffer.width = image.width;
        buffer.height = image.height;
        const auto converted = detail::shot_of(shot);
        detail::check(svbrdf_gcn_material_render(handle_.get(), &converted, &buffer));
        return image;
    }

    /// How far the material is from a photo: RMSE of values encoded with gamma 2.2 and clamped to 0 to 1.
    double photo_rmse(const Capture &capture, std::size_t index) const {
        double rmse = 0;
        detail::check(svbrdf_gcn_photo_rmse(handle_.get(), capture.get(), index, &rmse));
        return rmse;
    }

    /// What the fit did, as JSON; "null" if there was none.
    std::string report_json() const { return svbrdf_gcn_material_report_json(handle_.get()); }

    /// What may be expected of the maps, as the fit found. Reasons and what to do stand in `report_json`.
    Verdict verdict() const { return static_cast<Verdict>(svbrdf_gcn_material_verdict(handle_.get())); }

    /// What a user should know: of loaded maps those that have changed since they were saved; of the fit.
    std::vector<std::string> warnings() const {
        return detail::strings(svbrdf_gcn_material_warning, handle_.get());
    }

    const svbrdf_gcn_material *get() const noexcept { return handle_.get(); }

private:
    detail::Owner<svbrdf_gcn_material, svbrdf_gcn_material_destroy> handle_;
};

namespace detail {

inline Material fit(const svbrdf_gcn_model *model, const Capture &capture, const Options &options, const ProgressFunction &progress) {
    auto converted = initialised(svbrdf_gcn_options_init);
    converted.preset = static_cast<std::int32_t>(options.preset);
    converted.method = static_cast<std::int32_t>(options.method);
    converted.reflectance = static_cast<std::int32_t>(options.reflectance);
    converted.refine = static_cast<std::int32_t>(options.refine);
    converted.weights = options.weights.empty() ? nullptr : options.weights.c_str();
    converted.latent_steps = options.latent_steps.value_or(-1);
    converted.adapter_steps = options.adapter_steps.value_or(-1);
    converted.direct_steps = options.direct_steps.value_or(-1);
    converted.finish_steps = options.finish_steps.value_or(-1);
    converted.max_memory = options.max_memory.value_or(-1);
    converted.seed = options.seed;
    converted.threads = options.threads.value_or(-1);
    converted.early_stop = options.early_stop ? 1 : 0;
    converted.cancel = options.cancel ? options.cancel->get() : nullptr;
    return Material(reported<svbrdf_gcn_material>(converted, progress, [&](const auto *how, svbrdf_gcn_material **out) {
        return svbrdf_gcn_fit_material(model, capture.get(), how, out);
    }));
}

} // namespace detail

/// Recovers the material that the photos show, with the default network unless the options name another or the method direct.
inline Material fit_material(const Capture &capture, const Options &options = {}, const ProgressFunction &progress = {}) {
    return detail::fit(nullptr, capture, options, progress);
}

/// Trained networks: load them once, fit as often as you like, from any thread.
class Model {
public:
    /// Loads a weights file.
    static Model load(const std::string &path) { return Model(path.c_str()); }

    /// The default network, which is part of the library.
    static Model embedded() { return Model(nullptr); }

    Material fit_material(const Capture &capture, const Options &options = {}, const ProgressFunction &progress = {}) const {
        return detail::fit(handle_.get(), capture, options, progress);
    }

    /// The licence the weights come under.
    std::string license() const { return svbrdf_gcn_model_license(handle_.get()); }

    const svbrdf_gcn_model *get() const noexcept { return handle_.get(); }

private:
    explicit Model(const char *path)
        : handle_(detail::made<svbrdf_gcn_model>([&](svbrdf_gcn_model **out) { return svbrdf_gcn_model_load(path, out); })) {}

    detail::Owner<svbrdf_gcn_model, svbrdf_gcn_model_destroy> handle_;
};

} // namespace svbrdf_gcn

#endif
