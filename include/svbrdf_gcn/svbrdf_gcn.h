/* svbrdf-gcn: material maps from flash photos. Generated from ffi/src by `make header`; do not edit.
 *
 * Every function that can fail returns a status; svbrdf_gcn_last_error_message() has the words for it. Results come last in the arguments and are written
 * only where the status is SVBRDF_GCN_OK.
 *
 * Handles (svbrdf_gcn_capture, _material, _model, _cancel_token) are made by one function and ended by the _destroy of their type; what is lent of them
 * (views, strings) ends with them. Arguments are borrowed for the call. Strings and paths are UTF-8.
 *
 * Structs begin with their size: fill them by their _init function, which takes sizeof, and then change what you want. Fields are only ever added at the end, so that
 * a program and a library of different releases understand each other. Enums are passed as int32_t; unknown values are errors.
 *
 * Threads: a const handle may be used by any number of threads at once. Whoever changes or destroys a handle must be alone with it. Error messages are kept per
 * thread. No exception and no longjmp may pass through a callback.
 */

#ifndef SVBRDF_GCN_H
#define SVBRDF_GCN_H

#include <stddef.h>
#include <stdint.h>

/** The version this header belongs to. */
#define SVBRDF_GCN_VERSION "0.1.0"
#define SVBRDF_GCN_VERSION_MAJOR 0
#define SVBRDF_GCN_VERSION_MINOR 1
#define SVBRDF_GCN_VERSION_PATCH 0

/**
 * The version of this interface. It grows when a function or struct changes so that programs have to be compiled again.
 */
#define SVBRDF_GCN_ABI_VERSION 1

/**
 * What a call came to. Numbers are never used again for something else.
 */
enum svbrdf_gcn_status
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : int32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  /**
   * Done.
   */
  SVBRDF_GCN_OK = 0,
  /**
   * Asked to stop by the progress callback or a cancel token; nothing is wrong.
   */
  SVBRDF_GCN_CANCELLED = 1,
  /**
   * A pointer that must not be NULL is.
   */
  SVBRDF_GCN_ERR_NULL = 2,
  /**
   * A `struct_size` that no release had: the struct was not initialised.
   */
  SVBRDF_GCN_ERR_STRUCT_SIZE = 3,
  /**
   * A value out of its range, an unknown enum value, or options that contradict each other.
   */
  SVBRDF_GCN_ERR_INVALID_ARGUMENT = 4,
  /**
   * Sizes, channel counts or strides that do not fit.
   */
  SVBRDF_GCN_ERR_SHAPE = 5,
  /**
   * A pixel type, file format or colour space that is not read or written.
   */
  SVBRDF_GCN_ERR_FORMAT = 6,
  /**
   * Weights that are not there, corrupt, of another version, or for more photos than there are.
   */
  SVBRDF_GCN_ERR_WEIGHTS = 7,
  /**
   * A file that is missing, unreadable, broken, or cannot be written.
   */
  SVBRDF_GCN_ERR_IO = 8,
  /**
   * NaN or infinity in the loss or the maps.
   */
  SVBRDF_GCN_ERR_NON_FINITE = 9,
  /**
   * The run would need more memory than it may use.
   */
  SVBRDF_GCN_ERR_OUT_OF_MEMORY = 10,
  /**
   * A bug of the library; please report the message. Handles that were part of the call may only be destroyed.
   */
  SVBRDF_GCN_ERR_INTERNAL = 11,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum svbrdf_gcn_status svbrdf_gcn_status;
#else
typedef int32_t svbrdf_gcn_status;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

/**
 * What may be expected of fitted maps.
 */
enum svbrdf_gcn_verdict
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : int32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  /**
   * Not known: the material was not fitted.
   */
  SVBRDF_GCN_VERDICT_NONE = 0,
  /**
   * A new photo would hardly be told from its rendering, and nothing contradicts.
   */
  SVBRDF_GCN_VERDICT_GOOD = 1,
  /**
   * Right in the whole, with errors that can be seen.
   */
  SVBRDF_GCN_VERDICT_USABLE = 2,
  /**
   * Not what the photos show.
   */
  SVBRDF_GCN_VERDICT_POOR = 3,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum svbrdf_gcn_verdict svbrdf_gcn_verdict;
#else
typedef int32_t svbrdf_gcn_verdict;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

/**
 * How much time a fit may spend.
 */
enum svbrdf_gcn_preset
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : int32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  /**
   * A first look.
   */
  SVBRDF_GCN_PRESET_DRAFT = 0,
  /**
   * The default.
   */
  SVBRDF_GCN_PRESET_BALANCED = 1,
  /**
   * Until nothing is gained any more.
   */
  SVBRDF_GCN_PRESET_HIGH = 2,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum svbrdf_gcn_preset svbrdf_gcn_preset;
#else
typedef int32_t svbrdf_gcn_preset;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

/**
 * Which way leads from photos to maps.
 */
enum svbrdf_gcn_method
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : int32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  /**
   * The network.
   */
  SVBRDF_GCN_METHOD_AUTO = 0,
  /**
   * The network: the default one, fitted to the photos pixel by pixel, or that of the model or weights given.
   */
  SVBRDF_GCN_METHOD_NETWORK = 1,
  /**
   * Without a network: the maps themselves are optimised.
   */
  SVBRDF_GCN_METHOD_DIRECT = 2,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum svbrdf_gcn_method svbrdf_gcn_method;
#else
typedef int32_t svbrdf_gcn_method;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

/**
 * What a surface is taken to be made of. All maps come out in any case.
 */
enum svbrdf_gcn_reflectance
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : int32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  /**
   * The simplest that predicts photos left out as well as the others do; isotropic with one or two photos.
   */
  SVBRDF_GCN_REFLECTANCE_AUTO = 0,
  /**
   * Lambert's law alone: specular albedo 0, roughness 1.
   */
  SVBRDF_GCN_REFLECTANCE_DIFFUSE = 1,
  /**
   * A specular albedo near 4 %, the same for all channels.
   */
  SVBRDF_GCN_REFLECTANCE_DIELECTRIC = 2,
  /**
   * Any specular albedo, metals too.
   */
  SVBRDF_GCN_REFLECTANCE_ISOTROPIC = 3,
  /**
   * Two roughnesses and a tangent: brushed metal, satin, hair.
   */
  SVBRDF_GCN_REFLECTANCE_ANISOTROPIC = 4,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum svbrdf_gcn_reflectance svbrdf_gcn_reflectance;
#else
typedef int32_t svbrdf_gcn_reflectance;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

/**
 * What of the capture's own statements a fit may correct.
 */
enum svbrdf_gcn_refine
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : int32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  /**
   * What predicts photos left out better.
   */
  SVBRDF_GCN_REFINE_AUTO = 0,
  /**
   * Nothing: the stated light exactly.
   */
  SVBRDF_GCN_REFINE_NONE = 1,
  /**
   * A factor on the stated light of each photo.
   */
  SVBRDF_GCN_REFINE_LIGHT = 2,
  /**
   * That, and the position of camera and light, which move together.
   */
  SVBRDF_GCN_REFINE_ALL = 3,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum svbrdf_gcn_refine svbrdf_gcn_refine;
#else
typedef int32_t svbrdf_gcn_refine;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

/**
 * How stored pixel values relate to linear radiance. It is always stated, never guessed.
 */
enum svbrdf_gcn_transfer
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : int32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  /**
   * Not given: what the capture on disk states. Pixels from the host need one of the others.
   */
  SVBRDF_GCN_TRANSFER_FROM_CAPTURE = -1,
  /**
   * stored = linear^(1/2.2).
   */
  SVBRDF_GCN_TRANSFER_GAMMA22 = 0,
  /**
   * The piecewise curve of IEC 61966-2-1.
   */
  SVBRDF_GCN_TRANSFER_SRGB = 1,
  /**
   * stored = linear.
   */
  SVBRDF_GCN_TRANSFER_LINEAR = 2,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum svbrdf_gcn_transfer svbrdf_gcn_transfer;
#else
typedef int32_t svbrdf_gcn_transfer;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

/**
 * What a channel of a pixel is stored as.
 */
enum svbrdf_gcn_pixel_type
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : int32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  /**
   * `uint8_t`; 255 stands for 1.
   */
  SVBRDF_GCN_PIXEL_UINT8 = 1,
  /**
   * `uint16_t`; 65535 stands for 1.
   */
  SVBRDF_GCN_PIXEL_UINT16 = 2,
  /**
   * IEEE 754 half float, 2 bytes.
   */
  SVBRDF_GCN_PIXEL_HALF = 3,
  /**
   * `float`.
   */
  SVBRDF_GCN_PIXEL_FLOAT = 4,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum svbrdf_gcn_pixel_type svbrdf_gcn_pixel_type;
#else
typedef int32_t svbrdf_gcn_pixel_type;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

/**
 * The maps of a material.
 */
enum svbrdf_gcn_map_kind
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : int32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  /**
   * Diffuse albedo, 3 channels, linear RGB, 0 to 1.
   */
  SVBRDF_GCN_MAP_DIFFUSE_ALBEDO = 0,
  /**
   * Specular albedo: reflectance at normal incidence (F0), 3 channels, linear RGB, 0 to 1.
   */
  SVBRDF_GCN_MAP_SPECULAR_ALBEDO = 1,
  /**
   * Perceptual roughness, 1 channel, or 2 (x, y) of an anisotropic material, 0 to 1.
   */
  SVBRDF_GCN_MAP_ROUGHNESS = 2,
  /**
   * Unit normal, 3 channels, +x right, +y up, +z out of the surface, -1 to 1.
   */
  SVBRDF_GCN_MAP_NORMAL = 3,
  /**
   * Unit tangent of an anisotropic material, 3 channels, -1 to 1.
   */
  SVBRDF_GCN_MAP_TANGENT = 4,
  /**
   * Standard deviation of the diffuse albedo (root mean square over colours), 1 channel; of materials that a fit with the default network made.
   */
  SVBRDF_GCN_MAP_DIFFUSE_ALBEDO_DEVIATION = 5,
  /**
   * Likewise of the specular albedo.
   */
  SVBRDF_GCN_MAP_SPECULAR_ALBEDO_DEVIATION = 6,
  /**
   * Likewise of the roughness.
   */
  SVBRDF_GCN_MAP_ROUGHNESS_DEVIATION = 7,
  /**
   * Likewise of the normal: about an angle in radians.
   */
  SVBRDF_GCN_MAP_NORMAL_DEVIATION = 8,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum svbrdf_gcn_map_kind svbrdf_gcn_map_kind;
#else
typedef int32_t svbrdf_gcn_map_kind;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

/**
 * Primaries of linear colours.
 */
enum svbrdf_gcn_color_space
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : int32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  /**
   * Not given: what the capture on disk states, else Rec. 709.
   */
  SVBRDF_GCN_COLOR_SPACE_FROM_CAPTURE = -1,
  /**
   * The primaries of Rec. 709 and sRGB. Maps in memory, renderings and photos as the fit sees them are in these.
   */
  SVBRDF_GCN_COLOR_SPACE_REC709 = 0,
  /**
   * ACEScg.
   */
  SVBRDF_GCN_COLOR_SPACE_ACESCG = 1,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum svbrdf_gcn_color_space svbrdf_gcn_color_space;
#else
typedef int32_t svbrdf_gcn_color_space;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

/**
 * The program a material is exported for.
 */
enum svbrdf_gcn_export_target
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : int32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  /**
   * A `.mtlx` document with an OpenPBR surface, and 16-bit PNGs.
   */
  SVBRDF_GCN_EXPORT_MATERIALX = 0,
  /**
   * A `.gltf` with a plane to look at, KHR_materials_specular, and 8-bit PNGs.
   */
  SVBRDF_GCN_EXPORT_GLTF = 1,
  /**
   * The maps of Blender's Principled BSDF as 16-bit PNGs.
   */
  SVBRDF_GCN_EXPORT_PRINCIPLED = 2,
  /**
   * Base colour, occlusion-roughness-metallic, specular and normal as PNGs for Unreal.
   */
  SVBRDF_GCN_EXPORT_UNREAL = 3,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum svbrdf_gcn_export_target svbrdf_gcn_export_target;
#else
typedef int32_t svbrdf_gcn_export_target;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

/**
 * Which way green points in exported normal maps.
 */
enum svbrdf_gcn_normals
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : int32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  /**
   * As the target has it by itself.
   */
  SVBRDF_GCN_NORMALS_OF_TARGET = -1,
  /**
   * Up: +y.
   */
  SVBRDF_GCN_NORMALS_OPENGL = 0,
  /**
   * Down: -y.
   */
  SVBRDF_GCN_NORMALS_DIRECTX = 1,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum svbrdf_gcn_normals svbrdf_gcn_normals;
#else
typedef int32_t svbrdf_gcn_normals;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

/**
 * The image format of written maps.
 */
enum svbrdf_gcn_format
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : int32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  /**
   * OpenEXR with half floats, everything linear.
   */
  SVBRDF_GCN_FORMAT_EXR = 0,
  /**
   * PNG with 16 bits: albedos sRGB-encoded, the rest as data.
   */
  SVBRDF_GCN_FORMAT_PNG16 = 1,
  /**
   * TIFF with 32-bit floats, everything linear; loses nothing.
   */
  SVBRDF_GCN_FORMAT_TIFF = 2,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum svbrdf_gcn_format svbrdf_gcn_format;
#else
typedef int32_t svbrdf_gcn_format;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

/**
 * The parts of a fit, and of `svbrdf_gcn_acquire`. Later releases may add some.
 */
enum svbrdf_gcn_stage
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : int32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  /**
   * The photos pass through the network once.
   */
  SVBRDF_GCN_STAGE_ENCODE = 0,
  /**
   * The latent code is optimised.
   */
  SVBRDF_GCN_STAGE_LATENT = 1,
  /**
   * The adapters are optimised.
   */
  SVBRDF_GCN_STAGE_ADAPTERS = 2,
  /**
   * The maps themselves are optimised.
   */
  SVBRDF_GCN_STAGE_DIRECT = 3,
  /**
   * The predicted maps are fitted to the photos pixel by pixel.
   */
  SVBRDF_GCN_STAGE_FINISH = 4,
  /**
   * Photos of a printed sheet become a capture.
   */
  SVBRDF_GCN_STAGE_ACQUIRE = 5,
  /**
   * A part this release has no number for.
   */
  SVBRDF_GCN_STAGE_OTHER = -1,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum svbrdf_gcn_stage svbrdf_gcn_stage;
#else
typedef int32_t svbrdf_gcn_stage;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

/**
 * What a progress callback returns. Anything else stops the work with `SVBRDF_GCN_ERR_INVALID_ARGUMENT`.
 */
enum svbrdf_gcn_step
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : int32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  /**
   * Go on.
   */
  SVBRDF_GCN_CONTINUE = 0,
  /**
   * Stop; the call then returns `SVBRDF_GCN_CANCELLED`.
   */
  SVBRDF_GCN_STOP = 1,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum svbrdf_gcn_step svbrdf_gcn_step;
#else
typedef int32_t svbrdf_gcn_step;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

/**
 * A flag that stops fits, `svbrdf_gcn_acquire` and the reading of photos. It may be used from any thread, at any time while it lives. Once cancelled it stays cancelled:
 * what is started with it returns `SVBRDF_GCN_CANCELLED` at once; take a new one for the next run.
 */
typedef struct svbrdf_gcn_cancel_token svbrdf_gcn_cancel_token;

/**
 * Photos of one sample, all of the same size, and where camera and light stood for each.
 */
typedef struct svbrdf_gcn_capture svbrdf_gcn_capture;

/**
 * The maps of a material. Immutable: any number of threads may use it at once.
 */
typedef struct svbrdf_gcn_material svbrdf_gcn_material;

/**
 * The networks of a weights file. Immutable: any number of fits may use it at once.
 */
typedef struct svbrdf_gcn_model svbrdf_gcn_model;

/**
 * Where a fit, or `svbrdf_gcn_acquire`, stands. The library makes it; fields may be added at its end.
 */
typedef struct svbrdf_gcn_progress {
  /**
   * The size of the library's struct.
   */
  size_t struct_size;
  /**
   * A `svbrdf_gcn_stage`.
   */
  int32_t stage;
  /**
   * 1 if `loss` means something.
   */
  int32_t has_loss;
  /**
   * Steps of this stage that are done.
   */
  size_t step;
  /**
   * Steps this stage takes at most.
   */
  size_t steps;
  /**
   * The loss before the last step.
   */
  double loss;
} svbrdf_gcn_progress;

/**
 * Called on the thread that called `svbrdf_gcn_fit_material`, at least after every step and some ten times a second in long ones, or `svbrdf_gcn_acquire`, some
 * twenty times a second and at the end; never after that returned. `progress` is valid during the call. Returns a `svbrdf_gcn_step`. It must not throw, jump out, or
 * destroy what the call uses.
 */
typedef int32_t (*svbrdf_gcn_progress_fn)(void *user_data, const struct svbrdf_gcn_progress *progress);

/**
 * How photos of a printed sheet, or photos of which the patch's corners are known, become a capture; lengths are in millimetres. Always fill it with `svbrdf_gcn_acquire_options_init` first.
 */
typedef struct svbrdf_gcn_acquire_options {
  /**
   * `sizeof(svbrdf_gcn_acquire_options)`.
   */
  size_t struct_size;
  /**
   * Width of the window of our own sheet (`svbrdf-gcn sheet`); 100 by default.
   */
  double window;
  /**
   * The photos show the frame of svbrdf-diff-renderer instead, this wide from outer edge to outer edge; 0, the default: they do not.
   */
  double frame_width;
  /**
   * Length of the sheet's bar of 100 mm as it was printed; 100 by default.
   */
  double printed_bar;
  /**
   * How far the sample lies below the sheet's face; 0 by default, negative above it.
   */
  double depth;
  /**
   * Where the flash is, seen from the lens: to the right and up in photos as they were taken, before they were turned upright; at the lens by default.
   */
  double light_offset[2];
  /**
   * 1: where the flash is is found from the paper; 0, the default: it is where `light_offset` says.
   */
  int32_t find_light_offset;
  /**
   * UTF-8 path of a photo of the sheet without flash, exposed as the others: what it shows is subtracted. NULL, the default: there is none.
   */
  const char *dark_photo_utf8;
  /**
   * Diffuse albedo of the paper; 0.8 by default.
   */
  double paper_white;
  /**
   * Side of the rectified photos in pixels, 16 to 16384; -1, the default: 1024. They are never finer than the photos.
   */
  int64_t size;
  /**
   * Most bytes the work may use; -1, the default: three quarters of the free memory.
   */
  int64_t max_memory;
  /**
   * Called with the progress, on the thread that called `svbrdf_gcn_acquire`; NULL, the default: nobody is told.
   */
  svbrdf_gcn_progress_fn progress;
  /**
   * Handed to `progress` as it is.
   */
  void *progress_user_data;
  /**
   * Stops the work from another thread; NULL, the default: nothing does. It has to live until the call returns.
   */
  const struct svbrdf_gcn_cancel_token *cancel;
  /**
   * There is no sheet: eight numbers for each photo, the corners of the sample's square patch as x, y in pixels of the photo as viewers show it, from the upper left on
   * clockwise. NULL, the default: photos show a sheet. What is said of a sheet does not count beside them.
   */
  const double *corners;
  /**
   * Width of the patch whose corners are given; 0 by default.
   */
  double patch_width;
} svbrdf_gcn_acquire_options;

/**
 * How photos are read. Always fill it with `svbrdf_gcn_capture_options_init` first.
 */
typedef struct svbrdf_gcn_capture_options {
  /**
   * `sizeof(svbrdf_gcn_capture_options)`.
   */
  size_t struct_size;
  /**
   * Photos whose longer side is above this are resampled by area, in linear light, and so are the maps; -1, the default: none are.
   */
  int64_t size;
  /**
   * Only these photos of a capture on disk, counted from 0, in this order; NULL, the default: all. Borrowed for the call.
   */
  const size_t *views;
  /**
   * How many `views` there are.
   */
  size_t view_count;
  /**
   * A `svbrdf_gcn_transfer`. By default what the capture on disk states; pixels from the host need it.
   */
  int32_t transfer;
  /**
   * The stored value at which float pixels from the host are saturated; 0, the default: none are. Integers are from 98 % of their top code on.
   * Captures on disk state their own.
   */
  float white_level;
  /**
   * A `svbrdf_gcn_color_space`: that of linear photos and of their `light_intensity`; both are converted to Rec. 709. By default what the capture
   * on disk states, Rec. 709 for pixels from the host.
   */
  int32_t color_space;
  /**
   * 1: photos on disk are read as if their files held no colour profiles and said nothing else of their colours; 0, the default: what they say
   * counts where nothing states a `color_space`, with a warning (docs/color.md).
   */
  int32_t ignore_profiles;
  /**
   * Stops the reading from another thread, also while a photo is decoded: it then returns `SVBRDF_GCN_CANCELLED`. NULL, the default: nothing does. It has
   * to live until the call with these options returns; a capture made for pixels of the host keeps it in mind for the photos that are added.
   */
  const struct svbrdf_gcn_cancel_token *cancel;
  /**
   * Most bytes the run may use, from the reading of photos on; -1, the default: three quarters of the free memory. What photos need is known from
   * their files' headers, before any is decoded: `SVBRDF_GCN_ERR_OUT_OF_MEMORY` if it is more. Photos of the host count as they are kept.
   */
  int64_t max_memory;
  /**
   * RGB intensity of the light of every photo, as in `svbrdf_gcn_shot`, in place of what the capture on disk states, or of what is chosen for one photo alone; three
   * zeros, the default: not given. Photos of the host have theirs in their shots.
   */
  double light_intensity[3];
} svbrdf_gcn_capture_options;

/**
 * Pixels to be read. The value of channel c of the pixel in row y and column x is stored at
 * `data + y * row_stride + x * pixel_stride + c * channel_stride`; row 0 is the top one.
 *
 * Strides are in bytes and may be negative; `data` always points to the first channel of the top left pixel. A stride of 0 stands for a packed one:
 * channels side by side, then pixels, then rows (or, with strides given, whatever they leave: a row is then `width` pixels). Values need not be aligned.
 */
typedef struct svbrdf_gcn_image_view {
  /**
   * `sizeof(svbrdf_gcn_image_view)`.
   */
  size_t struct_size;
  /**
   * The top left pixel.
   */
  const void *data;
  /**
   * A `svbrdf_gcn_pixel_type`.
   */
  int32_t pixel_type;
  /**
   * Values per pixel. Photos: 1 (grey), 2 (grey, alpha), 3 (RGB) or 4 (RGB, alpha); alpha is ignored with a warning.
   */
  int32_t channels;
  /**
   * Columns.
   */
  size_t width;
  /**
   * Rows.
   */
  size_t height;
  /**
   * Bytes from a row to the one below.
   */
  ptrdiff_t row_stride;
  /**
   * Bytes from a pixel to its right neighbour.
   */
  ptrdiff_t pixel_stride;
  /**
   * Bytes from a channel to the next.
   */
  ptrdiff_t channel_stride;
} svbrdf_gcn_image_view;

/**
 * Where camera and light stood for a photo, in the capture's length unit: the sample is centred at the origin in the plane z = 0, x right,
 * y up, z towards the camera. Always fill it with `svbrdf_gcn_shot_init` first.
 */
typedef struct svbrdf_gcn_shot {
  /**
   * `sizeof(svbrdf_gcn_shot)`.
   */
  size_t struct_size;
  /**
   * What messages call the photo, UTF-8; NULL, the default: "photo" and its number. Borrowed for the call.
   */
  const char *name;
  /**
   * Position of the camera, z above 0.
   */
  double camera[3];
  /**
   * Position of the point light, z above 0; that of the camera for a flash beside the lens.
   */
  double light[3];
  /**
   * RGB intensity, in photo units times length squared: a white diffuse patch that faces the light at distance r has the radiance
   * `light_intensity / (pi r^2)`.
   */
  double light_intensity[3];
} svbrdf_gcn_shot;

/**
 * Pixels to be written: as `svbrdf_gcn_image_view`.
 */
typedef struct svbrdf_gcn_image_buffer {
  /**
   * `sizeof(svbrdf_gcn_image_buffer)`.
   */
  size_t struct_size;
  /**
   * The top left pixel.
   */
  void *data;
  /**
   * `SVBRDF_GCN_PIXEL_FLOAT` or `SVBRDF_GCN_PIXEL_HALF`.
   */
  int32_t pixel_type;
  /**
   * Values per pixel.
   */
  int32_t channels;
  /**
   * Columns.
   */
  size_t width;
  /**
   * Rows.
   */
  size_t height;
  /**
   * Bytes from a row to the one below.
   */
  ptrdiff_t row_stride;
  /**
   * Bytes from a pixel to its right neighbour.
   */
  ptrdiff_t pixel_stride;
  /**
   * Bytes from a channel to the next.
   */
  ptrdiff_t channel_stride;
} svbrdf_gcn_image_buffer;

/**
 * Options of a fit; the names are those of the command line, where the photos and the files have theirs too (see
 * `svbrdf_gcn_capture_options` and `svbrdf_gcn_save_options`). Always fill it with `svbrdf_gcn_options_init` first.
 */
typedef struct svbrdf_gcn_options {
  /**
   * `sizeof(svbrdf_gcn_options)`.
   */
  size_t struct_size;
  /**
   * A `svbrdf_gcn_preset`; balanced by default.
   */
  int32_t preset;
  /**
   * A `svbrdf_gcn_method`; auto by default.
   */
  int32_t method;
  /**
   * UTF-8 path of other weights than those built in (safetensors), for those who load no model: only the network that this capture takes is read. NULL by
   * default; give this or a model, not both.
   */
  const char *weights;
  /**
   * Steps on the latent code; -1, the default: the preset's.
   */
  int64_t latent_steps;
  /**
   * Steps on the adapters; -1, the default: the preset's.
   */
  int64_t adapter_steps;
  /**
   * Steps on the maps themselves; -1, the default: the preset's.
   */
  int64_t direct_steps;
  /**
   * Most bytes the run may use, photos and weights included; -1, the default: three quarters of the free memory beside these.
   */
  int64_t max_memory;
  /**
   * Seed of everything random; 0 by default. Same seed, threads and CPU: same bits.
   */
  uint64_t seed;
  /**
   * Threads; -1, the default: all the machine offers.
   */
  int32_t threads;
  /**
   * 1, the default: a stage stops when its loss has flattened; 0: it takes every step.
   */
  int32_t early_stop;
  /**
   * Called with the progress, on the thread that called `svbrdf_gcn_fit_material`; NULL, the default: nobody is told.
   */
  svbrdf_gcn_progress_fn progress;
  /**
   * Handed to `progress` as it is.
   */
  void *progress_user_data;
  /**
   * Stops the run from another thread; NULL, the default: nothing does. It has to live until the fit returns.
   */
  const struct svbrdf_gcn_cancel_token *cancel;
  /**
   * Steps of the per-pixel finish; -1, the default: the preset's; 0: none.
   */
  int64_t finish_steps;
  /**
   * A `svbrdf_gcn_reflectance`; auto by default. A network of the paper's form takes auto alone.
   */
  int32_t reflectance;
  /**
   * A `svbrdf_gcn_refine`; auto by default.
   */
  int32_t refine;
} svbrdf_gcn_options;

/**
 * How a material is written. Always fill it with `svbrdf_gcn_save_options_init` first.
 */
typedef struct svbrdf_gcn_save_options {
  /**
   * `sizeof(svbrdf_gcn_save_options)`.
   */
  size_t struct_size;
  /**
   * A `svbrdf_gcn_format`; OpenEXR by default.
   */
  int32_t format;
  /**
   * A `svbrdf_gcn_color_space`: that of the albedos in files that are linear; Rec. 709 by default.
   */
  int32_t color_space;
} svbrdf_gcn_save_options;

/**
 * How a material is exported. Always fill it with `svbrdf_gcn_export_options_init` first, then say the target.
 */
typedef struct svbrdf_gcn_export_options {
  /**
   * `sizeof(svbrdf_gcn_export_options)`.
   */
  size_t struct_size;
  /**
   * A `svbrdf_gcn_export_target`; MaterialX by default.
   */
  int32_t target;
  /**
   * A `svbrdf_gcn_normals`; the target's own convention by default. MaterialX and glTF define theirs.
   */
  int32_t normals;
  /**
   * What the material is called in the files and in their names: up to 64 letters, digits and underscores, a letter first. NULL, the default: "material".
   */
  const char *name;
  /**
   * 1, the default: the tilt of the whole surface is taken out of its normals, so that tiles of it make a plane; 0: it stays.
   */
  int32_t level;
} svbrdf_gcn_export_options;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

/**
 * The interface version of the library that is loaded; compare it with `SVBRDF_GCN_ABI_VERSION`.
 */
uint32_t svbrdf_gcn_abi_version(void);

/**
 * The version of the library that is loaded, as `SVBRDF_GCN_VERSION` spells it. Never NULL, valid for ever.
 */
const char *svbrdf_gcn_version(void);

/**
 * Makes a capture of photos that show the sample in the window of a printed sheet (`svbrdf-gcn sheet`, docs/capturing.md), or of which the patch's corners are known.
 *
 * `photo_paths_utf8` are the paths of `photo_count` files; `options` may be NULL for the defaults. Photos that cannot be used are left out, and named in the report
 * (`svbrdf_gcn_capture_report_json`) and among the warnings. Positions are in millimetres. Destroy the capture with `svbrdf_gcn_capture_destroy`.
 */
svbrdf_gcn_status svbrdf_gcn_acquire(const char *const *photo_paths_utf8,
                                     size_t photo_count,
                                     const struct svbrdf_gcn_acquire_options *options,
                                     struct svbrdf_gcn_capture **out);

/**
 * What `svbrdf_gcn_acquire` found, as JSON: `photos`, those `left_out` with the reason, `lenses`, `warnings`; `assumptions` where there was no sheet. "null" for captures that came about otherwise; NULL if
 * `capture` is. Valid as long as the capture.
 */
const char *svbrdf_gcn_capture_report_json(const struct svbrdf_gcn_capture *capture);

/**
 * Writes a capture that `svbrdf_gcn_acquire` made to a folder: `capture.json`, the rectified photos as OpenEXR, for each with saturated pixels a PNG that says which, and `contact-sheet.png`.
 * Others are `SVBRDF_GCN_ERR_INVALID_ARGUMENT`, and so is a folder whose files are not ours.
 */
svbrdf_gcn_status svbrdf_gcn_capture_save(const struct svbrdf_gcn_capture *capture,
                                          const char *folder_utf8);

/**
 * Reads a capture from disk: a folder, or a JSON file, as the command line does. `path_utf8` is UTF-8; `options` may be NULL. Destroy the
 * capture with `svbrdf_gcn_capture_destroy`.
 */
svbrdf_gcn_status svbrdf_gcn_capture_open(const char *path_utf8,
                                          const struct svbrdf_gcn_capture_options *options,
                                          struct svbrdf_gcn_capture **out);

/**
 * Makes a capture without photos, for pixels of the host; add them with `svbrdf_gcn_capture_add_photo`.
 *
 * `patch_size` is the width of the patch that the photos show, in the unit of the positions. `options` state the `transfer` function of the
 * pixels, and may state `size` and `white_level`; `views` are for captures on disk. Values out of range are found when the first photo is added. Destroy the capture with `svbrdf_gcn_capture_destroy`.
 */
svbrdf_gcn_status svbrdf_gcn_capture_create(double patch_size,
                                            const struct svbrdf_gcn_capture_options *options,
                                            struct svbrdf_gcn_capture **out);

/**
 * Adds a photo to a capture made by `svbrdf_gcn_capture_create`. Pixels are copied, converted to linear light and resampled to the capture's `size` before the
 * call returns. All photos have to have the same size. If the call fails the capture stays as it was. Nobody else may use the capture meanwhile.
 */
svbrdf_gcn_status svbrdf_gcn_capture_add_photo(struct svbrdf_gcn_capture *capture,
                                               const struct svbrdf_gcn_image_view *pixels,
                                               const struct svbrdf_gcn_shot *shot);

/**
 * Destroys a capture; no-op for NULL. Nobody else may use it; materials fitted to it live on.
 */
void svbrdf_gcn_capture_destroy(struct svbrdf_gcn_capture *capture);

/**
 * How many photos there are; 0 if `capture` is NULL.
 */
size_t svbrdf_gcn_capture_photo_count(const struct svbrdf_gcn_capture *capture);

/**
 * Columns of every photo after reading; 0 if there is none.
 */
size_t svbrdf_gcn_capture_width(const struct svbrdf_gcn_capture *capture);

/**
 * Rows of every photo after reading; 0 if there is none.
 */
size_t svbrdf_gcn_capture_height(const struct svbrdf_gcn_capture *capture);

/**
 * The pixels of photo `index` (from 0) as the fit sees them: linear RGB floats. The view is valid as long as the capture and until the next photo is added.
 */
svbrdf_gcn_status svbrdf_gcn_capture_photo(const struct svbrdf_gcn_capture *capture,
                                           size_t index,
                                           struct svbrdf_gcn_image_view *out);

/**
 * Where camera and light stood for photo `index` (from 0). `name` in it is NULL.
 */
svbrdf_gcn_status svbrdf_gcn_capture_shot(const struct svbrdf_gcn_capture *capture, size_t index, struct svbrdf_gcn_shot *out);

/**
 * What a user should know about how the photos were read: warning `index`, from 0, in UTF-8; NULL past the last. Valid as long as the capture and until
 * the next photo is added.
 */
const char *svbrdf_gcn_capture_warning(const struct svbrdf_gcn_capture *capture,
                                       size_t index);

/**
 * Sets `struct_size` and makes everything else 0: packed strides; the rest has to be filled in.
 */
svbrdf_gcn_status svbrdf_gcn_image_view_init(struct svbrdf_gcn_image_view *view, size_t struct_size);

/**
 * Sets `struct_size` and makes everything else 0: packed strides; the rest has to be filled in.
 */
svbrdf_gcn_status svbrdf_gcn_image_buffer_init(struct svbrdf_gcn_image_buffer *buffer, size_t struct_size);

/**
 * Recovers the material that the photos of `capture` show.
 *
 * `model` may be NULL: then the default network, which is part of the library. `options` may be NULL for the defaults. The call returns when the
 * fit is done or stopped; the progress callback runs on the calling thread. Any number of fits may run at once, of the same model and capture too.
 * Destroy the material with `svbrdf_gcn_material_destroy`.
 */
svbrdf_gcn_status svbrdf_gcn_fit_material(const struct svbrdf_gcn_model *model,
                                          const struct svbrdf_gcn_capture *capture,
                                          const struct svbrdf_gcn_options *options,
                                          struct svbrdf_gcn_material **out);

/**
 * Destroys a material, and with it its maps; no-op for NULL. Nobody else may use it.
 */
void svbrdf_gcn_material_destroy(struct svbrdf_gcn_material *material);

/**
 * A view of a map (`map_kind` is a `svbrdf_gcn_map_kind`): packed floats that live as long as the material. Set `out->struct_size` first
 * (`svbrdf_gcn_image_view_init`). An isotropic material has no tangent; asking for it is `SVBRDF_GCN_ERR_INVALID_ARGUMENT`, as it
 * is for a deviation that is not known.
 */
svbrdf_gcn_status svbrdf_gcn_material_map(const struct svbrdf_gcn_material *material, int32_t map_kind, struct svbrdf_gcn_image_view *out);

/**
 * Width of the patch in the capture's length unit; 0 if `material` is NULL.
 */
double svbrdf_gcn_material_patch_size(const struct svbrdf_gcn_material *material);

/**
 * Name of the unit of the patch's width, in UTF-8: that of the capture, or of the folder it was loaded from. NULL if it is not known or `material` is NULL.
 * Valid as long as the material.
 */
const char *svbrdf_gcn_material_unit(const struct svbrdf_gcn_material *material);

/**
 * What the fit did, as the JSON object that `material.json` holds under `report`: settings, stages, losses, errors of the photos, warnings; `null` if the
 * material was loaded from files that have none. NULL if `material` is. Valid as long as the material.
 */
const char *svbrdf_gcn_material_report_json(const struct svbrdf_gcn_material *material);

/**
 * What may be expected of the maps, as the fit found; kept when a material is saved and loaded. The reasons and what to do stand in
 * `svbrdf_gcn_material_report_json`. `SVBRDF_GCN_VERDICT_NONE` if there was no fit or `material` is NULL.
 */
svbrdf_gcn_verdict svbrdf_gcn_material_verdict(const struct svbrdf_gcn_material *material);

/**
 * What a user should know, of loaded maps those that have changed since they were saved, then of the fit: warning `index`, from 0, in UTF-8; NULL past the last. Valid as long as the material.
 */
const char *svbrdf_gcn_material_warning(const struct svbrdf_gcn_material *material,
                                        size_t index);

/**
 * Writes the maps and `material.json` to a folder (UTF-8 path), which is made if it is not there: the files that the command line writes. A material that is
 * there is replaced as a whole, or, if the call fails, left as it was. A file of one of these names that svbrdf-gcn did not write is
 * `SVBRDF_GCN_ERR_INVALID_ARGUMENT`. `options` may be NULL.
 */
svbrdf_gcn_status svbrdf_gcn_material_save(const struct svbrdf_gcn_material *material,
                                           const char *folder_utf8,
                                           const struct svbrdf_gcn_save_options *options);

/**
 * Reads a folder with a `material.json` (UTF-8 path). Destroy the material with `svbrdf_gcn_material_destroy`.
 */
svbrdf_gcn_status svbrdf_gcn_material_load(const char *folder_utf8, struct svbrdf_gcn_material **out);

/**
 * Writes the material for another program to a folder (UTF-8 path), which is made if it is not there. `export.json` in it says what every file holds, and
 * what the program cannot hold of this material.
 */
svbrdf_gcn_status svbrdf_gcn_material_export(const struct svbrdf_gcn_material *material,
                                             const char *folder_utf8,
                                             const struct svbrdf_gcn_export_options *options);

/**
 * Renders the material from the camera and under the light of `shot`, with the model the fit uses: linear RGB, written to `out`, which has the size of
 * the maps and 3 channels of float or half. Nothing is written if the call fails.
 */
svbrdf_gcn_status svbrdf_gcn_material_render(const struct svbrdf_gcn_material *material,
                                             const struct svbrdf_gcn_shot *shot,
                                             struct svbrdf_gcn_image_buffer *out);

/**
 * How far the material, rendered as photo `index` (from 0) of `capture` was taken, is from the photo: root mean square error of values encoded with gamma
 * 2.2 and clamped to 0 to 1. The maps must have the size of the photos and show the same patch: widths in known units (mm, cm, m, in) are converted; where a unit is not
 * stated the numbers must agree. Else it is `SVBRDF_GCN_ERR_INVALID_ARGUMENT`.
 */
svbrdf_gcn_status svbrdf_gcn_photo_rmse(const struct svbrdf_gcn_material *material,
                                        const struct svbrdf_gcn_capture *capture,
                                        size_t index,
                                        double *out);

/**
 * Loads the networks of a weights file (UTF-8 path). NULL means the default network, which is part of the library and which a fit without
 * a model takes. Destroy the model with `svbrdf_gcn_model_destroy`.
 */
svbrdf_gcn_status svbrdf_gcn_model_load(const char *weights_path_utf8, struct svbrdf_gcn_model **out);

/**
 * The licence the weights come under, as their file states it; NULL if `model` is. Valid as long as the model.
 */
const char *svbrdf_gcn_model_license(const struct svbrdf_gcn_model *model);

/**
 * Destroys a model; no-op for NULL. Fits that use it must have returned.
 */
void svbrdf_gcn_model_destroy(struct svbrdf_gcn_model *model);

/**
 * Fills the options of a fit with their defaults. `struct_size` is `sizeof(svbrdf_gcn_options)`.
 */
svbrdf_gcn_status svbrdf_gcn_options_init(struct svbrdf_gcn_options *options, size_t struct_size);

/**
 * Fills capture options with their defaults. `struct_size` is `sizeof(svbrdf_gcn_capture_options)`.
 */
svbrdf_gcn_status svbrdf_gcn_capture_options_init(struct svbrdf_gcn_capture_options *options, size_t struct_size);

/**
 * Fills acquire options with their defaults. `struct_size` is `sizeof(svbrdf_gcn_acquire_options)`.
 */
svbrdf_gcn_status svbrdf_gcn_acquire_options_init(struct svbrdf_gcn_acquire_options *options, size_t struct_size);

/**
 * Sets `struct_size` and makes everything else 0; the rest has to be filled in. `struct_size` is `sizeof(svbrdf_gcn_shot)`.
 */
svbrdf_gcn_status svbrdf_gcn_shot_init(struct svbrdf_gcn_shot *shot, size_t struct_size);

/**
 * Fills save options with their defaults. `struct_size` is `sizeof(svbrdf_gcn_save_options)`.
 */
svbrdf_gcn_status svbrdf_gcn_save_options_init(struct svbrdf_gcn_save_options *options, size_t struct_size);

/**
 * Fills export options with their defaults. `struct_size` is `sizeof(svbrdf_gcn_export_options)`.
 */
svbrdf_gcn_status svbrdf_gcn_export_options_init(struct svbrdf_gcn_export_options *options, size_t struct_size);

/**
 * Makes a token that is not cancelled. Destroy it with `svbrdf_gcn_cancel_token_destroy`.
 */
svbrdf_gcn_status svbrdf_gcn_cancel_token_create(struct svbrdf_gcn_cancel_token **out);

/**
 * Asks every fit that was started with the token to stop, and those that will be. Returns at once, from any thread.
 */
svbrdf_gcn_status svbrdf_gcn_cancel_token_cancel(const struct svbrdf_gcn_cancel_token *token);

/**
 * 1 if the token was cancelled, 0 if not or if it is NULL.
 */
int32_t svbrdf_gcn_cancel_token_is_cancelled(const struct svbrdf_gcn_cancel_token *token);

/**
 * Destroys a token; no-op for NULL. Fits that use it must have returned.
 */
void svbrdf_gcn_cancel_token_destroy(struct svbrdf_gcn_cancel_token *token);

/**
 * What the last call of this thread that did not return `SVBRDF_GCN_OK` had to say, in English and UTF-8; empty if there was none.
 * Never NULL. Valid until this thread's next call of any function but this one.
 */
const char *svbrdf_gcn_last_error_message(void);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* SVBRDF_GCN_H */
