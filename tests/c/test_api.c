/* The C interface as a C99 program sees it: test_api SAMPLES OUT [quick]
 * quick: smaller, fewer photos and steps, for valgrind; what a fit achieves is then not judged. */
#define _POSIX_C_SOURCE 200809L
#include <math.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include <svbrdf_gcn/svbrdf_gcn.h>

static int passed, failed;

static void check_(int ok, const char *what, const char *test, int line) {
    if (ok) {
        passed++;
    } else {
        failed++;
        fprintf(stderr, "FAILED %s, line %d: %s (last error: %s)\n", test, line, what, svbrdf_gcn_last_error_message());
    }
}
#define CHECK(condition) check_((condition) != 0, #condition, __func__, __LINE__)
/* The status, and a word of the message. */
#define FAILS(call, expected, word) \
    do { \
        CHECK((call) == (expected)); \
        CHECK(strstr(svbrdf_gcn_last_error_message(), word) != NULL); \
    } while (0)
#define OK(call) CHECK((call) == SVBRDF_GCN_OK)

static const char *samples, *out_folder;
static int quick;
static int64_t size_pixels = 64, steps = 100;

static char *path_of(char *buffer, const char *folder, const char *name) {
    snprintf(buffer, 1024, "%s/%s", folder, name);
    return buffer;
}

static svbrdf_gcn_options draft(void) {
    svbrdf_gcn_options options;
    OK(svbrdf_gcn_options_init(&options, sizeof options));
    options.preset = SVBRDF_GCN_PRESET_DRAFT;
    options.method = SVBRDF_GCN_METHOD_DIRECT;
    options.direct_steps = steps;
    options.seed = 7;
    options.threads = 2;
    options.early_stop = 0;
    return options;
}

static svbrdf_gcn_capture *open_sample(const char *name, const size_t *views, size_t count) {
    char path[1024];
    svbrdf_gcn_capture *capture = NULL;
    svbrdf_gcn_capture_options options;
    OK(svbrdf_gcn_capture_options_init(&options, sizeof options));
    options.size = size_pixels;
    options.views = views;
    options.view_count = count;
    OK(svbrdf_gcn_capture_open(path_of(path, samples, name), &options, &capture));
    return capture;
}

static svbrdf_gcn_material *fit(const svbrdf_gcn_capture *capture) {
    svbrdf_gcn_material *material = NULL;
    svbrdf_gcn_options options = draft();
    OK(svbrdf_gcn_fit_material(NULL, capture, &options, &material));
    return material;
}

static svbrdf_gcn_image_view map(const svbrdf_gcn_material *material, int32_t kind) {
    svbrdf_gcn_image_view view;
    OK(svbrdf_gcn_image_view_init(&view, sizeof view));
    OK(svbrdf_gcn_material_map(material, kind, &view));
    return view;
}

static int same_pixels(svbrdf_gcn_image_view a, svbrdf_gcn_image_view b) {
    return a.width == b.width && a.height == b.height && a.channels == b.channels &&
           memcmp(a.data, b.data, a.height * (size_t)a.row_stride) == 0;
}

static int same_maps(const svbrdf_gcn_material *a, const svbrdf_gcn_material *b) {
    int32_t kind;
    for (kind = SVBRDF_GCN_MAP_DIFFUSE_ALBEDO; kind <= SVBRDF_GCN_MAP_NORMAL; kind++) {
        if (!same_pixels(map(a, kind), map(b, kind))) {
            return 0;
        }
    }
    return 1;
}

static void versions(void) {
    char version[64];
    CHECK(svbrdf_gcn_abi_version() == SVBRDF_GCN_ABI_VERSION);
    CHECK(strcmp(svbrdf_gcn_version(), SVBRDF_GCN_VERSION) == 0);
    snprintf(version, sizeof version, "%d.%d.%d", SVBRDF_GCN_VERSION_MAJOR, SVBRDF_GCN_VERSION_MINOR, SVBRDF_GCN_VERSION_PATCH);
    CHECK(strcmp(version, SVBRDF_GCN_VERSION) == 0);
}

static void null_pointers(const svbrdf_gcn_capture *capture, const svbrdf_gcn_material *material) {
    svbrdf_gcn_capture *made_capture = NULL;
    svbrdf_gcn_material *made_material = NULL;
    svbrdf_gcn_capture_options capture_options;
    svbrdf_gcn_shot shot;
    svbrdf_gcn_image_view view;
    svbrdf_gcn_image_buffer buffer;
    double rmse;
    OK(svbrdf_gcn_capture_options_init(&capture_options, sizeof capture_options));
    OK(svbrdf_gcn_shot_init(&shot, sizeof shot));
    OK(svbrdf_gcn_image_view_init(&view, sizeof view));
    OK(svbrdf_gcn_image_buffer_init(&buffer, sizeof buffer));

    FAILS(svbrdf_gcn_options_init(NULL, sizeof(svbrdf_gcn_options)), SVBRDF_GCN_ERR_NULL, "options");
    FAILS(svbrdf_gcn_capture_open(NULL, NULL, &made_capture), SVBRDF_GCN_ERR_NULL, "path_utf8");
    FAILS(svbrdf_gcn_capture_open("x", NULL, NULL), SVBRDF_GCN_ERR_NULL, "out");
    FAILS(svbrdf_gcn_capture_create(1.0, NULL, &made_capture), SVBRDF_GCN_ERR_NULL, "options");
    FAILS(svbrdf_gcn_capture_create(1.0, &capture_options, NULL), SVBRDF_GCN_ERR_NULL, "out");
    FAILS(svbrdf_gcn_capture_add_photo(NULL, &view, &shot), SVBRDF_GCN_ERR_NULL, "capture");
    FAILS(svbrdf_gcn_capture_photo(NULL, 0, &view), SVBRDF_GCN_ERR_NULL, "capture");
    FAILS(svbrdf_gcn_capture_photo(capture, 0, NULL), SVBRDF_GCN_ERR_NULL, "out");
    FAILS(svbrdf_gcn_capture_shot(capture, 0, NULL), SVBRDF_GCN_ERR_NULL, "out");
    FAILS(svbrdf_gcn_fit_material(NULL, NULL, NULL, &made_material), SVBRDF_GCN_ERR_NULL, "capture");
    FAILS(svbrdf_gcn_fit_material(NULL, capture, NULL, NULL), SVBRDF_GCN_ERR_NULL, "out");
    FAILS(svbrdf_gcn_material_map(NULL, 0, &view), SVBRDF_GCN_ERR_NULL, "material");
    FAILS(svbrdf_gcn_material_map(material, 0, NULL), SVBRDF_GCN_ERR_NULL, "out");
    FAILS(svbrdf_gcn_material_save(NULL, "x", NULL), SVBRDF_GCN_ERR_NULL, "material");
    FAILS(svbrdf_gcn_material_save(material, NULL, NULL), SVBRDF_GCN_ERR_NULL, "folder_utf8");
    FAILS(svbrdf_gcn_material_load(NULL, &made_material), SVBRDF_GCN_ERR_NULL, "folder_utf8");
    FAILS(svbrdf_gcn_material_render(material, NULL, &buffer), SVBRDF_GCN_ERR_NULL, "shot");
    FAILS(svbrdf_gcn_material_render(material, &shot, NULL), SVBRDF_GCN_ERR_NULL, "out");
    FAILS(svbrdf_gcn_material_render(material, &shot, &buffer), SVBRDF_GCN_ERR_NULL, "out.data");
    FAILS(svbrdf_gcn_photo_rmse(material, capture, 0, NULL), SVBRDF_GCN_ERR_NULL, "out");
    FAILS(svbrdf_gcn_photo_rmse(NULL, capture, 0, &rmse), SVBRDF_GCN_ERR_NULL, "material");
    FAILS(svbrdf_gcn_model_load("x", NULL), SVBRDF_GCN_ERR_NULL, "out");
    FAILS(svbrdf_gcn_cancel_token_create(NULL), SVBRDF_GCN_ERR_NULL, "out");
    FAILS(svbrdf_gcn_cancel_token_cancel(NULL), SVBRDF_GCN_ERR_NULL, "token");
    capture_options.view_count = 3;
    FAILS(svbrdf_gcn_capture_open("x", &capture_options, &made_capture), SVBRDF_GCN_ERR_NULL, "views");

    CHECK(svbrdf_gcn_capture_photo_count(NULL) == 0 && svbrdf_gcn_capture_width(NULL) == 0 && svbrdf_gcn_capture_height(NULL) == 0);
    CHECK(svbrdf_gcn_capture_warning(NULL, 0) == NULL && svbrdf_gcn_material_warning(NULL, 0) == NULL);
    CHECK(svbrdf_gcn_material_report_json(NULL) == NULL && svbrdf_gcn_model_license(NULL) == NULL);
    CHECK(svbrdf_gcn_cancel_token_is_cancelled(NULL) == 0);
    svbrdf_gcn_capture_destroy(NULL);
    svbrdf_gcn_material_destroy(NULL);
    svbrdf_gcn_model_destroy(NULL);
    svbrdf_gcn_cancel_token_destroy(NULL);
    CHECK(made_capture == NULL && made_material == NULL);
}

static void struct_sizes(const svbrdf_gcn_capture *capture) {
    /* What a program of a later release would hand over. */
    struct {
        svbrdf_gcn_image_view view;
        double more;
    } longer;
    svbrdf_gcn_material *material = NULL;
    svbrdf_gcn_options options = draft();
    svbrdf_gcn_image_view view;
    FAILS(svbrdf_gcn_options_init(&options, sizeof(size_t)), SVBRDF_GCN_ERR_STRUCT_SIZE, "struct_size");
    options.struct_size = sizeof(size_t);
    FAILS(svbrdf_gcn_fit_material(NULL, capture, &options, &material), SVBRDF_GCN_ERR_STRUCT_SIZE, "options");
    options.struct_size = 0;
    FAILS(svbrdf_gcn_fit_material(NULL, capture, &options, &material), SVBRDF_GCN_ERR_STRUCT_SIZE, "got 0");
    memset(&options, 0xff, sizeof options);
    FAILS(svbrdf_gcn_fit_material(NULL, capture, &options, &material), SVBRDF_GCN_ERR_STRUCT_SIZE, "options");
    CHECK(material == NULL);

    memset(&view, 0, sizeof view);
    FAILS(svbrdf_gcn_capture_photo(capture, 0, &view), SVBRDF_GCN_ERR_STRUCT_SIZE, "out");
    CHECK(view.data == NULL);
    OK(svbrdf_gcn_image_view_init(&longer.view, sizeof longer));
    CHECK(longer.view.struct_size == sizeof longer && longer.more == 0);
    longer.more = 5;
    OK(svbrdf_gcn_capture_photo(capture, 0, &longer.view));
    CHECK(longer.view.struct_size == sizeof longer && longer.more == 5 && longer.view.data != NULL);
}

static void bad_values(const svbrdf_gcn_capture *capture, const svbrdf_gcn_material *material) {
    char path[1024];
    svbrdf_gcn_material *made = NULL;
    svbrdf_gcn_capture *made_capture = NULL;
    svbrdf_gcn_model *model = NULL;
    svbrdf_gcn_options options;
    svbrdf_gcn_capture_options capture_options;
    svbrdf_gcn_save_options save_options;
    svbrdf_gcn_image_view view;
    double rmse = -1;
    const size_t views[] = {0, 900};

#define BAD_OPTION(field, value, status, word) \
    options = draft(); \
    options.field = value; \
    FAILS(svbrdf_gcn_fit_material(NULL, capture, &options, &made), status, word)
    BAD_OPTION(preset, 3, SVBRDF_GCN_ERR_INVALID_ARGUMENT, "preset: expected one of 0, 1, 2, got 3");
    BAD_OPTION(preset, INT32_MIN, SVBRDF_GCN_ERR_INVALID_ARGUMENT, "preset");
    BAD_OPTION(method, -1, SVBRDF_GCN_ERR_INVALID_ARGUMENT, "method");
    BAD_OPTION(early_stop, 2, SVBRDF_GCN_ERR_INVALID_ARGUMENT, "early_stop");
    BAD_OPTION(threads, 0, SVBRDF_GCN_ERR_INVALID_ARGUMENT, "threads");
    BAD_OPTION(threads, -7, SVBRDF_GCN_ERR_INVALID_ARGUMENT, "threads");
    BAD_OPTION(latent_steps, -2, SVBRDF_GCN_ERR_INVALID_ARGUMENT, "latent_steps");
    BAD_OPTION(direct_steps, INT64_MIN, SVBRDF_GCN_ERR_INVALID_ARGUMENT, "direct_steps");
    BAD_OPTION(finish_steps, -2, SVBRDF_GCN_ERR_INVALID_ARGUMENT, "finish_steps");
    BAD_OPTION(max_memory, 1, SVBRDF_GCN_ERR_OUT_OF_MEMORY, "max_memory");
    BAD_OPTION(weights, "no/such/weights", SVBRDF_GCN_ERR_IO, "no/such/weights");
    BAD_OPTION(weights, "\xff\xfe", SVBRDF_GCN_ERR_INVALID_ARGUMENT, "UTF-8");
    CHECK(made == NULL);

    FAILS(svbrdf_gcn_capture_open("no/such/folder", NULL, &made_capture), SVBRDF_GCN_ERR_IO, "no/such/folder");
    FAILS(svbrdf_gcn_capture_open("\xff", NULL, &made_capture), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "UTF-8");
    FAILS(svbrdf_gcn_capture_open("", NULL, &made_capture), SVBRDF_GCN_ERR_IO, "");
    FAILS(svbrdf_gcn_capture_open(samples, NULL, &made_capture), SVBRDF_GCN_ERR_FORMAT, "capture.json");
    path_of(path, samples, "tiles");
    OK(svbrdf_gcn_capture_options_init(&capture_options, sizeof capture_options));
    capture_options.transfer = 3;
    FAILS(svbrdf_gcn_capture_open(path, &capture_options, &made_capture), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "transfer");
    OK(svbrdf_gcn_capture_options_init(&capture_options, sizeof capture_options));
    capture_options.color_space = 2;
    FAILS(svbrdf_gcn_capture_open(path, &capture_options, &made_capture), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "color_space");
    OK(svbrdf_gcn_capture_options_init(&capture_options, sizeof capture_options));
    capture_options.ignore_profiles = 2;
    FAILS(svbrdf_gcn_capture_open(path, &capture_options, &made_capture), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "ignore_profiles");
    OK(svbrdf_gcn_capture_options_init(&capture_options, sizeof capture_options));
    capture_options.max_memory = 100000;
    FAILS(svbrdf_gcn_capture_open(path, &capture_options, &made_capture), SVBRDF_GCN_ERR_OUT_OF_MEMORY, "allowed are 100000");
    capture_options.max_memory = -2;
    FAILS(svbrdf_gcn_capture_open(path, &capture_options, &made_capture), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "max_memory");
    OK(svbrdf_gcn_capture_options_init(&capture_options, sizeof capture_options));
    capture_options.size = 0;
    FAILS(svbrdf_gcn_capture_open(path, &capture_options, &made_capture), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "size");
    OK(svbrdf_gcn_capture_options_init(&capture_options, sizeof capture_options));
    capture_options.white_level = 1;
    FAILS(svbrdf_gcn_capture_open(path, &capture_options, &made_capture), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "white_level");
    OK(svbrdf_gcn_capture_options_init(&capture_options, sizeof capture_options));
    capture_options.views = views;
    capture_options.view_count = 2;
    FAILS(svbrdf_gcn_capture_open(path, &capture_options, &made_capture), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "900");
    capture_options.view_count = SIZE_MAX;
    FAILS(svbrdf_gcn_capture_open(path, &capture_options, &made_capture), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "view_count");
    capture_options.view_count = 0;
    FAILS(svbrdf_gcn_capture_open(path, &capture_options, &made_capture), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "views");
    CHECK(made_capture == NULL);

    OK(svbrdf_gcn_image_view_init(&view, sizeof view));
    FAILS(svbrdf_gcn_material_map(material, 9, &view), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "map_kind");
    /* The fit of these tests runs without a network. */
    FAILS(svbrdf_gcn_material_map(material, SVBRDF_GCN_MAP_NORMAL_DEVIATION, &view), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "deviations");
    FAILS(svbrdf_gcn_material_map(material, SVBRDF_GCN_MAP_TANGENT, &view), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "tangent");
    FAILS(svbrdf_gcn_capture_photo(capture, 99, &view), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "photo 99");
    FAILS(svbrdf_gcn_photo_rmse(material, capture, SIZE_MAX, &rmse), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "photo");
    CHECK(rmse == -1 && view.data == NULL);

    OK(svbrdf_gcn_save_options_init(&save_options, sizeof save_options));
    save_options.format = 12;
    FAILS(svbrdf_gcn_material_save(material, path_of(path, out_folder, "never"), &save_options), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "format");
    save_options.format = SVBRDF_GCN_FORMAT_EXR;
    save_options.color_space = SVBRDF_GCN_COLOR_SPACE_FROM_CAPTURE;
    FAILS(svbrdf_gcn_material_save(material, path, &save_options), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "color_space");
    FAILS(svbrdf_gcn_material_save(material, "/dev/null/maps", NULL), SVBRDF_GCN_ERR_IO, "/dev/null");
    FAILS(svbrdf_gcn_material_load("no/such/folder", &made), SVBRDF_GCN_ERR_IO, "no/such/folder");

    OK(svbrdf_gcn_model_load(NULL, &model));
    CHECK(strcmp(svbrdf_gcn_model_license(model), "CC0-1.0") == 0);
    svbrdf_gcn_model_destroy(model);
    model = NULL;
    FAILS(svbrdf_gcn_model_load("no/such/weights", &model), SVBRDF_GCN_ERR_IO, "no/such/weights");
    FAILS(svbrdf_gcn_model_load(path_of(path, samples, "tiles/00.png"), &model), SVBRDF_GCN_ERR_WEIGHTS, "weights");
    CHECK(model == NULL);
}

/* From a folder: maps in range, photos that the fit did not see. */
static void folder_fit(const svbrdf_gcn_capture *capture, const svbrdf_gcn_material *material) {
    static const size_t unseen[] = {7, 8};
    svbrdf_gcn_capture *rest = open_sample("tiles", unseen, 2);
    svbrdf_gcn_image_view roughness = map(material, SVBRDF_GCN_MAP_ROUGHNESS), normal = map(material, SVBRDF_GCN_MAP_NORMAL);
    size_t i, pixels = normal.width * normal.height;
    double rmse;
    int in_range = 1, unit = 1;

    CHECK(svbrdf_gcn_capture_photo_count(capture) == (quick ? 3 : 7));
    CHECK((int64_t)svbrdf_gcn_capture_width(capture) == size_pixels && (int64_t)svbrdf_gcn_capture_height(capture) == size_pixels);
    CHECK((int64_t)normal.width == size_pixels && (int64_t)normal.height == size_pixels);
    CHECK(roughness.channels == 1 && normal.channels == 3 && normal.pixel_type == SVBRDF_GCN_PIXEL_FLOAT);
    for (i = 0; i < pixels; i++) {
        const float *n = (const float *)normal.data + 3 * i;
        float r = ((const float *)roughness.data)[i];
        in_range &= r >= 0 && r <= 1;
        unit &= fabsf(n[0] * n[0] + n[1] * n[1] + n[2] * n[2] - 1) < 1e-5f;
    }
    CHECK(in_range && unit);
    CHECK(svbrdf_gcn_material_patch_size(material) == 10.0 && strcmp(svbrdf_gcn_material_unit(material), "cm") == 0);
    CHECK(svbrdf_gcn_material_unit(NULL) == NULL);
    CHECK(strstr(svbrdf_gcn_material_report_json(material), "\"method\":\"direct\"") != NULL);
    CHECK(svbrdf_gcn_material_warning(material, 0) == NULL);
    for (i = 0; i < 2 && !quick; i++) {
        OK(svbrdf_gcn_photo_rmse(material, rest, i, &rmse));
        /* 0.082 and 0.052 were measured. */
        CHECK(rmse < 0.1);
    }
    FAILS(svbrdf_gcn_photo_rmse(material, rest, 2, &rmse), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "2 photos");
    svbrdf_gcn_capture_destroy(rest);
}

static void files(const svbrdf_gcn_material *material, const svbrdf_gcn_capture *capture) {
    static const struct {
        int32_t format;
        const char *name, *file;
        float tolerance;
    } formats[] = {{SVBRDF_GCN_FORMAT_EXR, "c-exr", "diffuse.exr", 1e-3f},
                   {SVBRDF_GCN_FORMAT_PNG16, "c-png16", "diffuse.png", 1e-4f},
                   {SVBRDF_GCN_FORMAT_TIFF, "c-tiff", "diffuse.tif", 1e-6f}};
    char folder[1024], file[2048];
    struct stat status;
    size_t i, j;
    for (i = 0; i < 3; i++) {
        svbrdf_gcn_material *loaded = NULL;
        svbrdf_gcn_image_view a, b;
        svbrdf_gcn_save_options options;
        float worst = 0;
        double rmse[2];
        OK(svbrdf_gcn_save_options_init(&options, sizeof options));
        options.format = formats[i].format;
        OK(svbrdf_gcn_material_save(material, path_of(folder, out_folder, formats[i].name), &options));
        snprintf(file, sizeof file, "%s/%s", folder, formats[i].file);
        CHECK(stat(file, &status) == 0 && status.st_size > 0);
        OK(svbrdf_gcn_material_load(folder, &loaded));
        a = map(material, SVBRDF_GCN_MAP_DIFFUSE_ALBEDO);
        b = map(loaded, SVBRDF_GCN_MAP_DIFFUSE_ALBEDO);
        for (j = 0; j < a.width * a.height * 3; j++) {
            worst = fmaxf(worst, fabsf(((const float *)a.data)[j] - ((const float *)b.data)[j]));
        }
        CHECK(worst < formats[i].tolerance);
        CHECK(strstr(svbrdf_gcn_material_report_json(loaded), "\"seed\":7") != NULL);
        CHECK(strcmp(svbrdf_gcn_material_unit(loaded), "cm") == 0);
        OK(svbrdf_gcn_photo_rmse(material, capture, 0, &rmse[0]));
        OK(svbrdf_gcn_photo_rmse(loaded, capture, 0, &rmse[1]));
        CHECK(fabs(rmse[0] - rmse[1]) < 1e-3);
        CHECK(svbrdf_gcn_material_warning(loaded, 0) == NULL);
        svbrdf_gcn_material_destroy(loaded);
        /* A map that changed since is read with a warning. */
        if (formats[i].format == SVBRDF_GCN_FORMAT_TIFF) {
            FILE *changed = fopen(file, "ab");
            CHECK(changed != NULL && fputc(0, changed) == 0 && fclose(changed) == 0);
            OK(svbrdf_gcn_material_load(folder, &loaded));
            CHECK(strstr(svbrdf_gcn_material_warning(loaded, 0), "diffuse.tif") != NULL);
            CHECK(svbrdf_gcn_material_warning(loaded, 1) == NULL);
            svbrdf_gcn_material_destroy(loaded);
            /* A file of somebody else's is not replaced. */
            changed = fopen(file, "wb");
            CHECK(changed != NULL && fputc('x', changed) == 'x' && fclose(changed) == 0);
            snprintf(file, sizeof file, "%s/material.json", folder);
            CHECK(remove(file) == 0);
            FAILS(svbrdf_gcn_material_save(material, folder, &options), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "diffuse.tif");
        }
    }
}

/* Half float of a value that is 0 or normal as one, cut off. */
static uint16_t half_of(float value) {
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return value == 0 ? 0 : (uint16_t)(((bits >> 13) - (112u << 10)) & 0x7fff);
}

static svbrdf_gcn_capture *host_capture(int32_t transfer, double patch_size) {
    svbrdf_gcn_capture *capture = NULL;
    svbrdf_gcn_capture_options options;
    OK(svbrdf_gcn_capture_options_init(&options, sizeof options));
    options.transfer = transfer;
    OK(svbrdf_gcn_capture_create(patch_size, &options, &capture));
    return capture;
}

static svbrdf_gcn_image_view pixels_of(const void *data, int32_t type, size_t width, size_t height, int32_t channels) {
    svbrdf_gcn_image_view view;
    OK(svbrdf_gcn_image_view_init(&view, sizeof view));
    view.data = data;
    view.pixel_type = type;
    view.width = width;
    view.height = height;
    view.channels = channels;
    return view;
}

/* A material is judged by photos of its own patch alone. */
static void other_patches(const svbrdf_gcn_material *material) {
    static const uint8_t grey[3] = {128, 128, 128};
    svbrdf_gcn_image_view pixels = pixels_of(grey, SVBRDF_GCN_PIXEL_UINT8, 1, 1, 3);
    svbrdf_gcn_capture *capture = host_capture(SVBRDF_GCN_TRANSFER_SRGB, 3.0);
    svbrdf_gcn_shot shot;
    double rmse = -1;
    OK(svbrdf_gcn_shot_init(&shot, sizeof shot));
    shot.camera[2] = shot.light[2] = 9;
    shot.light_intensity[0] = shot.light_intensity[1] = shot.light_intensity[2] = 100;
    OK(svbrdf_gcn_capture_add_photo(capture, &pixels, &shot));
    FAILS(svbrdf_gcn_photo_rmse(material, capture, 0, &rmse), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "the capture's patch is 3 (no unit stated) wide, the material's 10 cm");
    CHECK(rmse == -1);
    svbrdf_gcn_capture_destroy(capture);
}

static svbrdf_gcn_image_view photo(const svbrdf_gcn_capture *capture, size_t index) {
    svbrdf_gcn_image_view view;
    OK(svbrdf_gcn_image_view_init(&view, sizeof view));
    OK(svbrdf_gcn_capture_photo(capture, index, &view));
    return view;
}

static svbrdf_gcn_shot shot_of(const svbrdf_gcn_capture *capture, size_t index) {
    svbrdf_gcn_shot shot;
    OK(svbrdf_gcn_shot_init(&shot, sizeof shot));
    OK(svbrdf_gcn_capture_shot(capture, index, &shot));
    return shot;
}

static void exports(const svbrdf_gcn_material *material) {
    static const struct {
        int32_t target;
        const char *folder, *file;
    } targets[] = {{SVBRDF_GCN_EXPORT_MATERIALX, "c-materialx", "tiles.mtlx"},
                   {SVBRDF_GCN_EXPORT_GLTF, "c-gltf", "tiles.gltf"},
                   {SVBRDF_GCN_EXPORT_PRINCIPLED, "c-principled", "base_color.png"},
                   {SVBRDF_GCN_EXPORT_UNREAL, "c-unreal", "T_tiles_ORM.png"}};
    char folder[1024], file[2048];
    struct stat status;
    svbrdf_gcn_export_options options;
    size_t i;
    OK(svbrdf_gcn_export_options_init(&options, sizeof options));
    options.name = "tiles";
    for (i = 0; i < 4; i++) {
        options.target = targets[i].target;
        OK(svbrdf_gcn_material_export(material, path_of(folder, out_folder, targets[i].folder), &options));
        snprintf(file, sizeof file, "%s/%s", folder, targets[i].file);
        CHECK(stat(file, &status) == 0 && status.st_size > 0);
        CHECK(stat(path_of(file, folder, "export.json"), &status) == 0 && status.st_size > 0);
    }
    FAILS(svbrdf_gcn_material_export(material, folder, NULL), SVBRDF_GCN_ERR_NULL, "options");
    FAILS(svbrdf_gcn_material_export(material, NULL, &options), SVBRDF_GCN_ERR_NULL, "folder_utf8");
    FAILS(svbrdf_gcn_material_export(NULL, folder, &options), SVBRDF_GCN_ERR_NULL, "material");
    options.name = "2 tiles";
    FAILS(svbrdf_gcn_material_export(material, folder, &options), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "2 tiles");
    options.name = NULL;
    options.target = 4;
    FAILS(svbrdf_gcn_material_export(material, folder, &options), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "target");
    options.target = SVBRDF_GCN_EXPORT_GLTF;
    options.normals = SVBRDF_GCN_NORMALS_DIRECTX;
    FAILS(svbrdf_gcn_material_export(material, folder, &options), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "opengl");
    options.normals = 7;
    FAILS(svbrdf_gcn_material_export(material, folder, &options), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "normals");
    options.normals = SVBRDF_GCN_NORMALS_OF_TARGET;
    CHECK(options.level == 1);
    options.level = 2;
    FAILS(svbrdf_gcn_material_export(material, folder, &options), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "level");
}

/* A linear capture in ACEScg and its colours: what is written in ACEScg is the same material. */
static void color_spaces(const svbrdf_gcn_material *material) {
    /* ACEScg (1, 1, 1) is white, and so is Rec. 709 (1, 1, 1); a saturated red of Rec. 709 is not as far out in ACEScg. */
    static const float pixels[6] = {1, 1, 1, 0.6131f, 0.0702f, 0.0206f};
    char folder[1024];
    svbrdf_gcn_capture *capture = NULL;
    svbrdf_gcn_material *loaded = NULL;
    svbrdf_gcn_capture_options options;
    svbrdf_gcn_save_options save_options;
    svbrdf_gcn_image_view view = pixels_of(pixels, SVBRDF_GCN_PIXEL_FLOAT, 2, 1, 3), a, b;
    svbrdf_gcn_shot shot;
    const float expected[6] = {1, 1, 1, 1, 0, 0};
    float worst = 0;
    size_t i;
    OK(svbrdf_gcn_capture_options_init(&options, sizeof options));
    options.transfer = SVBRDF_GCN_TRANSFER_LINEAR;
    options.color_space = SVBRDF_GCN_COLOR_SPACE_ACESCG;
    OK(svbrdf_gcn_capture_create(1.0, &options, &capture));
    OK(svbrdf_gcn_shot_init(&shot, sizeof shot));
    shot.camera[2] = shot.light[2] = 3;
    shot.light_intensity[0] = shot.light_intensity[1] = shot.light_intensity[2] = 9;
    OK(svbrdf_gcn_capture_add_photo(capture, &view, &shot));
    for (i = 0; i < 6; i++) {
        worst = fmaxf(worst, fabsf(((const float *)photo(capture, 0).data)[i] - expected[i]));
    }
    CHECK(worst < 1e-3f);
    svbrdf_gcn_capture_destroy(capture);

    OK(svbrdf_gcn_save_options_init(&save_options, sizeof save_options));
    save_options.format = SVBRDF_GCN_FORMAT_TIFF;
    save_options.color_space = SVBRDF_GCN_COLOR_SPACE_ACESCG;
    OK(svbrdf_gcn_material_save(material, path_of(folder, out_folder, "c-acescg"), &save_options));
    OK(svbrdf_gcn_material_load(folder, &loaded));
    a = map(material, SVBRDF_GCN_MAP_DIFFUSE_ALBEDO);
    b = map(loaded, SVBRDF_GCN_MAP_DIFFUSE_ALBEDO);
    worst = 0;
    for (i = 0; i < a.width * a.height * 3; i++) {
        worst = fmaxf(worst, fabsf(((const float *)a.data)[i] - ((const float *)b.data)[i]));
    }
    CHECK(worst < 1e-5f);
    svbrdf_gcn_material_destroy(loaded);
}

/* What a fit is told while it runs. */
typedef struct {
    size_t calls, stop_at, last_step;
    int32_t returned;
    pthread_t thread;
    int same_thread, sane;
    const svbrdf_gcn_cancel_token *cancel;
    int32_t stage;
    size_t steps;
} Watch;

static int32_t watch(void *user_data, const svbrdf_gcn_progress *progress) {
    Watch *state = user_data;
    state->calls++;
    state->same_thread &= pthread_equal(state->thread, pthread_self());
    state->sane &= progress->struct_size >= sizeof *progress && progress->stage == state->stage &&
                   progress->steps == state->steps && progress->step <= progress->steps && progress->step >= state->last_step;
    state->last_step = progress->step;
    if (progress->step < state->stop_at) {
        return SVBRDF_GCN_CONTINUE;
    }
    if (state->cancel != NULL) {
        svbrdf_gcn_cancel_token_cancel(state->cancel);
    }
    return state->returned;
}

static svbrdf_gcn_status watched(const svbrdf_gcn_capture *capture, Watch *state, const svbrdf_gcn_cancel_token *token,
                                 svbrdf_gcn_material **out) {
    svbrdf_gcn_options options = draft();
    state->thread = pthread_self();
    state->same_thread = state->sane = 1;
    state->stage = SVBRDF_GCN_STAGE_DIRECT;
    state->steps = (size_t)steps;
    options.progress = watch;
    options.progress_user_data = state;
    options.cancel = token;
    return svbrdf_gcn_fit_material(NULL, capture, &options, out);
}

static void *cancel_later(void *token) {
    struct timespec moment = {0, 20 * 1000 * 1000};
    nanosleep(&moment, NULL);
    svbrdf_gcn_cancel_token_cancel(token);
    return NULL;
}

static void cancelling(const svbrdf_gcn_capture *capture, const svbrdf_gcn_material *expected) {
    svbrdf_gcn_cancel_token *token = NULL, *other = NULL;
    svbrdf_gcn_material *material = NULL;
    svbrdf_gcn_options options;
    pthread_t thread;
    size_t i;

    /* By the callback: at the start, in the middle, after the last step. */
    for (i = 0; i < 3; i++) {
        Watch state = {0};
        state.stop_at = (size_t)steps * i / 2;
        state.returned = SVBRDF_GCN_STOP;
        FAILS(watched(capture, &state, NULL, &material), SVBRDF_GCN_CANCELLED, "cancelled");
        CHECK(state.calls > 0 && state.same_thread && state.sane && state.last_step >= state.stop_at);
        CHECK(material == NULL);
    }
    {
        Watch state = {0};
        state.returned = 2;
        FAILS(watched(capture, &state, NULL, &material), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "got 2");
        CHECK(state.calls == 1 && material == NULL);
    }

    /* By a token: in the middle, then again, which is at the start. */
    OK(svbrdf_gcn_cancel_token_create(&token));
    CHECK(svbrdf_gcn_cancel_token_is_cancelled(token) == 0);
    {
        Watch state = {0};
        state.stop_at = (size_t)steps / 2;
        state.returned = SVBRDF_GCN_CONTINUE;
        state.cancel = token;
        CHECK(watched(capture, &state, token, &material) == SVBRDF_GCN_CANCELLED);
        CHECK(state.last_step < (size_t)steps && material == NULL);
        CHECK(svbrdf_gcn_cancel_token_is_cancelled(token) == 1);
        state.calls = 0;
        CHECK(watched(capture, &state, token, &material) == SVBRDF_GCN_CANCELLED);
        CHECK(state.calls == 0 && material == NULL);
    }
    svbrdf_gcn_cancel_token_destroy(token);

    /* A token that is cancelled stops the reading of photos, too: from disk and from the host, whose capture stays as it was. */
    {
        svbrdf_gcn_capture_options reading;
        svbrdf_gcn_capture *made = NULL;
        svbrdf_gcn_image_view pixels;
        svbrdf_gcn_shot shot;
        char path[512];
        OK(svbrdf_gcn_cancel_token_create(&token));
        OK(svbrdf_gcn_capture_options_init(&reading, sizeof reading));
        CHECK(reading.cancel == NULL);
        reading.cancel = token;
        reading.transfer = SVBRDF_GCN_TRANSFER_LINEAR;
        OK(svbrdf_gcn_capture_create(1.0, &reading, &made));
        OK(svbrdf_gcn_image_view_init(&pixels, sizeof pixels));
        OK(svbrdf_gcn_shot_init(&shot, sizeof shot));
        OK(svbrdf_gcn_capture_photo(capture, 0, &pixels));
        OK(svbrdf_gcn_capture_shot(capture, 0, &shot));
        OK(svbrdf_gcn_capture_add_photo(made, &pixels, &shot));
        CHECK(svbrdf_gcn_capture_photo_count(made) == 1);
        OK(svbrdf_gcn_cancel_token_cancel(token));
        FAILS(svbrdf_gcn_capture_add_photo(made, &pixels, &shot), SVBRDF_GCN_CANCELLED, "cancelled");
        CHECK(svbrdf_gcn_capture_photo_count(made) == 1);
        svbrdf_gcn_capture_destroy(made);
        made = NULL;
        path_of(path, samples, "tiles");
        reading.transfer = SVBRDF_GCN_TRANSFER_FROM_CAPTURE;
        FAILS(svbrdf_gcn_capture_open(path, &reading, &made), SVBRDF_GCN_CANCELLED, "cancelled");
        CHECK(made == NULL);
        svbrdf_gcn_cancel_token_destroy(token);
    }

    /* From another thread, in a fit that would take very long. */
    OK(svbrdf_gcn_cancel_token_create(&token));
    options = draft();
    options.direct_steps = 1000000;
    options.cancel = token;
    CHECK(pthread_create(&thread, NULL, cancel_later, token) == 0);
    CHECK(svbrdf_gcn_fit_material(NULL, capture, &options, &material) == SVBRDF_GCN_CANCELLED);
    CHECK(pthread_join(thread, NULL) == 0 && material == NULL);

    /* Another token, the same capture, and the bits of a fit that nobody disturbed; cancelling after the end does nothing to it. */
    OK(svbrdf_gcn_cancel_token_create(&other));
    {
        Watch state = {0};
        state.stop_at = (size_t)steps + 1;
        OK(watched(capture, &state, other, &material));
        CHECK(state.last_step == (size_t)steps && state.same_thread && state.sane);
    }
    OK(svbrdf_gcn_cancel_token_cancel(other));
    CHECK(same_maps(material, expected));
    svbrdf_gcn_cancel_token_destroy(token);
    svbrdf_gcn_cancel_token_destroy(other);
    svbrdf_gcn_material_destroy(material);
}

/* Photos of a printed sheet; under valgrind, which takes minutes for one, only what is refused. */
static void acquiring(void) {
    /* Of the first photo clockwise, of the second not. */
    const double corners[16] = {20, 20, 230, 22, 235, 230, 18, 236, 20, 20, 18, 236, 235, 230, 230, 22};
    char paths[5][1024], text[1024];
    const char *photos[5], *photo;
    size_t count = 5, i;
    svbrdf_gcn_acquire_options options;
    svbrdf_gcn_options fit_options = draft();
    svbrdf_gcn_capture *capture = NULL, *loaded = NULL, *none = NULL;
    svbrdf_gcn_material *material = NULL;
    svbrdf_gcn_cancel_token *token = NULL;
    svbrdf_gcn_shot shot, saved;
    Watch state = {0};
    for (i = 0; i < count; i++) {
        snprintf(text, sizeof text, "phone/%d.jpg", (int)i + 1);
        photos[i] = path_of(paths[i], samples, text);
    }
    OK(svbrdf_gcn_acquire_options_init(&options, sizeof options));
    CHECK(options.window == 100.0 && options.frame_width == 0.0 && options.printed_bar == 100.0 && options.depth == 0.0 && options.paper_white == 0.8);
    CHECK(options.size == -1 && options.max_memory == -1 && options.progress == NULL && options.cancel == NULL);
    options.size = 64;
    options.depth = 1.0;

    FAILS(svbrdf_gcn_acquire(NULL, 1, &options, &none), SVBRDF_GCN_ERR_NULL, "photo_paths_utf8");
    FAILS(svbrdf_gcn_acquire(photos, count, &options, NULL), SVBRDF_GCN_ERR_NULL, "out");
    FAILS(svbrdf_gcn_acquire(photos, 0, &options, &none), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "got 0");
    FAILS(svbrdf_gcn_acquire(photos, (size_t)-1, &options, &none), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "photo_count");
    options.struct_size = 8;
    FAILS(svbrdf_gcn_acquire(photos, count, &options, &none), SVBRDF_GCN_ERR_STRUCT_SIZE, "svbrdf_gcn_acquire_options_init");
    options.struct_size = sizeof options;
    options.printed_bar = 9.8;
    FAILS(svbrdf_gcn_acquire(photos, count, &options, &none), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "printed_bar: expected the printed length of 100 mm");
    options.printed_bar = 100.0;
    options.frame_width = 5.0;
    FAILS(svbrdf_gcn_acquire(photos, count, &options, &none), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "frame_width");
    options.frame_width = 0.0;
    options.size = -2;
    FAILS(svbrdf_gcn_acquire(photos, count, &options, &none), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "size");
    options.size = 64;
    options.max_memory = 1000;
    FAILS(svbrdf_gcn_acquire(photos, count, &options, &none), SVBRDF_GCN_ERR_OUT_OF_MEMORY, "allowed are 1000");
    options.max_memory = -1;
    options.patch_width = 96;
    FAILS(svbrdf_gcn_acquire(photos, count, &options, &none), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "patch_width: is that of the patch whose corners are given");
    options.corners = corners;
    FAILS(svbrdf_gcn_acquire(photos, 2, &options, &none), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "corners: of photo 1");
    FAILS(svbrdf_gcn_acquire(photos, 1, &options, &none), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "depth");
    options.depth = 0;
    path_of(text, samples, "tiles/00.png");
    photo = text;
    OK(svbrdf_gcn_acquire(&photo, 1, &options, &capture));
    CHECK(strstr(svbrdf_gcn_capture_report_json(capture), "\"assumptions\":[\"the patch is a flat square") != NULL);
    svbrdf_gcn_capture_destroy(capture);
    capture = NULL;
    options.corners = NULL;
    options.patch_width = 0;
    options.depth = 1;
    if (quick) {
        photos[0] = path_of(paths[0], samples, "tiles/00.png");
        FAILS(svbrdf_gcn_acquire(photos, 1, &options, &none), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "none can be used");
        CHECK(none == NULL);
        return;
    }

    /* Stopped by the callback at the start, in the middle and at the end; by a token. */
    options.progress = watch;
    options.progress_user_data = &state;
    state.thread = pthread_self();
    state.stage = SVBRDF_GCN_STAGE_ACQUIRE;
    state.steps = 2 * count;
    state.same_thread = state.sane = 1;
    for (i = 0; i < 3; i++) {
        state.stop_at = count * i;
        state.returned = SVBRDF_GCN_STOP;
        state.last_step = 0;
        FAILS(svbrdf_gcn_acquire(photos, count, &options, &none), SVBRDF_GCN_CANCELLED, "cancelled");
        CHECK(state.last_step >= state.stop_at);
    }
    state.stop_at = state.last_step = 0;
    state.returned = 2;
    FAILS(svbrdf_gcn_acquire(photos, count, &options, &none), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "got 2");
    state.returned = SVBRDF_GCN_CONTINUE;
    OK(svbrdf_gcn_cancel_token_create(&token));
    OK(svbrdf_gcn_cancel_token_cancel(token));
    options.cancel = token;
    FAILS(svbrdf_gcn_acquire(photos, count, &options, &none), SVBRDF_GCN_CANCELLED, "cancelled");
    options.cancel = NULL;
    svbrdf_gcn_cancel_token_destroy(token);
    CHECK(none == NULL);

    state.last_step = 0;
    OK(svbrdf_gcn_acquire(photos, count, &options, &capture));
    CHECK(state.last_step == 2 * count && state.same_thread && state.sane);
    CHECK(svbrdf_gcn_capture_photo_count(capture) == count && svbrdf_gcn_capture_width(capture) == 64);
    CHECK(strstr(svbrdf_gcn_capture_report_json(capture), "\"photo\":\"1.jpg\"") != NULL);
    FAILS(svbrdf_gcn_capture_add_photo(capture, NULL, NULL), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "takes no more photos");
    OK(svbrdf_gcn_capture_save(capture, path_of(text, out_folder, "acquired")));
    OK(svbrdf_gcn_capture_open(text, NULL, &loaded));
    FAILS(svbrdf_gcn_capture_save(loaded, text), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "svbrdf_gcn_acquire made");
    CHECK(strcmp(svbrdf_gcn_capture_report_json(loaded), "null") == 0);
    OK(svbrdf_gcn_shot_init(&shot, sizeof shot));
    OK(svbrdf_gcn_shot_init(&saved, sizeof saved));
    for (i = 0; i < count; i++) {
        OK(svbrdf_gcn_capture_shot(capture, i, &shot));
        OK(svbrdf_gcn_capture_shot(loaded, i, &saved));
        CHECK(shot.camera[2] > 150 && shot.camera[2] < 350);
        CHECK(memcmp(&shot.camera, &saved.camera, sizeof shot.camera) == 0);
    }
    fit_options.direct_steps = 3;
    OK(svbrdf_gcn_fit_material(NULL, capture, &fit_options, &material));
    svbrdf_gcn_material_destroy(material);
    svbrdf_gcn_capture_destroy(capture);
    svbrdf_gcn_capture_destroy(loaded);
    CHECK(svbrdf_gcn_capture_report_json(NULL) == NULL);
    FAILS(svbrdf_gcn_capture_save(NULL, "x"), SVBRDF_GCN_ERR_NULL, "capture");
}

/* The light of one photo alone. */
static void stated_light(void) {
    char path[1024];
    svbrdf_gcn_capture *capture = NULL;
    svbrdf_gcn_capture_options options;
    svbrdf_gcn_shot shot;
    OK(svbrdf_gcn_capture_options_init(&options, sizeof options));
    OK(svbrdf_gcn_shot_init(&shot, sizeof shot));
    options.size = size_pixels;
    options.light_intensity[0] = 17;
    options.light_intensity[1] = 18;
    options.light_intensity[2] = 19;
    OK(svbrdf_gcn_capture_open(path_of(path, samples, "tiles/00.png"), &options, &capture));
    OK(svbrdf_gcn_capture_shot(capture, 0, &shot));
    CHECK(shot.light_intensity[0] == 17 && shot.light_intensity[1] == 18 && shot.light_intensity[2] == 19);
    svbrdf_gcn_capture_destroy(capture);
    capture = NULL;
    options.transfer = SVBRDF_GCN_TRANSFER_LINEAR;
    FAILS(svbrdf_gcn_capture_create(1.0, &options, &capture), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "light_intensity");
    options.transfer = SVBRDF_GCN_TRANSFER_FROM_CAPTURE;
    options.light_intensity[1] = -1;
    FAILS(svbrdf_gcn_capture_open(path, &options, &capture), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "light_intensity");
    CHECK(capture == NULL);
}

typedef struct {
    const svbrdf_gcn_capture *capture;
    svbrdf_gcn_material *material;
    int quiet;
} Job;

static void *fit_job(void *data) {
    Job *job = data;
    svbrdf_gcn_options options = draft();
    job->quiet = svbrdf_gcn_last_error_message()[0] == '\0';
    if (svbrdf_gcn_fit_material(NULL, job->capture, &options, &job->material) != SVBRDF_GCN_OK) {
        job->material = NULL;
    }
    return NULL;
}

static void two_at_once(const svbrdf_gcn_capture *capture, const svbrdf_gcn_material *expected) {
    Job jobs[2] = {{capture, NULL, 0}, {capture, NULL, 0}};
    pthread_t threads[2];
    int i;
    /* This thread has an error message, the new ones must not. */
    CHECK(svbrdf_gcn_cancel_token_cancel(NULL) == SVBRDF_GCN_ERR_NULL);
    for (i = 0; i < 2; i++) {
        CHECK(pthread_create(&threads[i], NULL, fit_job, &jobs[i]) == 0);
    }
    for (i = 0; i < 2; i++) {
        CHECK(pthread_join(threads[i], NULL) == 0);
        CHECK(jobs[i].quiet && jobs[i].material != NULL);
        CHECK(jobs[i].material != NULL && same_maps(jobs[i].material, expected));
        svbrdf_gcn_material_destroy(jobs[i].material);
    }
}

/* The same pixels, laid out in memory in other ways and as other types. */
static void layouts(void) {
    enum { WIDTH = 5, HEIGHT = 4, COUNT = WIDTH * HEIGHT * 3 };
    uint8_t packed[COUNT], other[COUNT], wide[HEIGHT * 32], four[WIDTH * HEIGHT * 4];
    uint16_t words[COUNT], halves[COUNT];
    float floats[COUNT];
    svbrdf_gcn_shot shot;
    svbrdf_gcn_image_view view;
    svbrdf_gcn_capture *capture = host_capture(SVBRDF_GCN_TRANSFER_SRGB, 2.0), *linear = host_capture(SVBRDF_GCN_TRANSFER_LINEAR, 2.0);
    size_t x, y, c, i, photos = 0, worst = 0;

    OK(svbrdf_gcn_shot_init(&shot, sizeof shot));
    shot.camera[2] = shot.light[2] = 5;
    shot.light_intensity[0] = shot.light_intensity[1] = shot.light_intensity[2] = 70;
    for (i = 0; i < COUNT; i++) {
        packed[i] = (uint8_t)(i * 37 % 251);
        words[i] = (uint16_t)(packed[i] * 257);
        floats[i] = (float)packed[i] / 255.0f;
        halves[i] = half_of((float)(packed[i] & 0xf8) / 256.0f);
    }

#define ADD(description, bytes_of_row, bytes_of_pixel, bytes_of_channel) \
    view = description; \
    view.row_stride = bytes_of_row; \
    view.pixel_stride = bytes_of_pixel; \
    view.channel_stride = bytes_of_channel; \
    OK(svbrdf_gcn_capture_add_photo(capture, &view, &shot)); \
    CHECK(svbrdf_gcn_capture_photo_count(capture) == ++photos); \
    CHECK(same_pixels(photo(capture, photos - 1), photo(capture, 0)))

    ADD(pixels_of(packed, SVBRDF_GCN_PIXEL_UINT8, WIDTH, HEIGHT, 3), 0, 0, 0);
    /* Rows with padding. */
    for (y = 0; y < HEIGHT; y++) {
        memset(wide + 32 * y, 0xee, 32);
        memcpy(wide + 32 * y, packed + WIDTH * 3 * y, WIDTH * 3);
    }
    ADD(pixels_of(wide, SVBRDF_GCN_PIXEL_UINT8, WIDTH, HEIGHT, 3), 32, 0, 0);
    /* Bottom up. */
    for (y = 0; y < HEIGHT; y++) {
        memcpy(other + WIDTH * 3 * (HEIGHT - 1 - y), packed + WIDTH * 3 * y, WIDTH * 3);
    }
    ADD(pixels_of(other + WIDTH * 3 * (HEIGHT - 1), SVBRDF_GCN_PIXEL_UINT8, WIDTH, HEIGHT, 3), -WIDTH * 3, 0, 0);
    /* All the way backwards: BGR, right to left, bottom up. */
    for (i = 0; i < COUNT; i++) {
        other[COUNT - 1 - i] = packed[i];
    }
    ADD(pixels_of(other + COUNT - 1, SVBRDF_GCN_PIXEL_UINT8, WIDTH, HEIGHT, 3), -WIDTH * 3, -3, -1);
    /* Planes, the columns of each side by side. */
    for (y = 0; y < HEIGHT; y++) {
        for (x = 0; x < WIDTH; x++) {
            for (c = 0; c < 3; c++) {
                other[(c * WIDTH + x) * HEIGHT + y] = packed[(y * WIDTH + x) * 3 + c];
            }
        }
    }
    ADD(pixels_of(other, SVBRDF_GCN_PIXEL_UINT8, WIDTH, HEIGHT, 3), 1, HEIGHT, WIDTH * HEIGHT);
    /* RGBA, alpha ignored with a warning; then the same as RGB with a stride. */
    for (i = 0; i < WIDTH * HEIGHT; i++) {
        memcpy(four + 4 * i, packed + 3 * i, 3);
        four[4 * i + 3] = (uint8_t)i;
    }
    CHECK(svbrdf_gcn_capture_warning(capture, 0) == NULL);
    ADD(pixels_of(four, SVBRDF_GCN_PIXEL_UINT8, WIDTH, HEIGHT, 4), 0, 0, 0);
    CHECK(strstr(svbrdf_gcn_capture_warning(capture, 0), "alpha") != NULL);
    ADD(pixels_of(four, SVBRDF_GCN_PIXEL_UINT8, WIDTH, HEIGHT, 3), WIDTH * 4, 4, 1);
    /* 16 bits: 257 times as much means the same to a bit or two of the float. */
    OK(svbrdf_gcn_capture_add_photo(capture, (view = pixels_of(words, SVBRDF_GCN_PIXEL_UINT16, WIDTH, HEIGHT, 3), &view), &shot));
    for (i = 0; i < COUNT; i++) {
        float a = ((const float *)photo(capture, 0).data)[i], b = ((const float *)photo(capture, photos).data)[i];
        worst += fabsf(a - b) > 1e-6f;
    }
    CHECK(worst == 0);
    /* Linear floats and halves come through as they are. */
    OK(svbrdf_gcn_capture_add_photo(linear, (view = pixels_of(floats, SVBRDF_GCN_PIXEL_FLOAT, WIDTH, HEIGHT, 3), &view), &shot));
    CHECK(memcmp(photo(linear, 0).data, floats, sizeof floats) == 0);
    OK(svbrdf_gcn_capture_add_photo(linear, (view = pixels_of(halves, SVBRDF_GCN_PIXEL_HALF, WIDTH, HEIGHT, 3), &view), &shot));
    for (i = 0; i < COUNT; i++) {
        CHECK(((const float *)photo(linear, 1).data)[i] == (float)(packed[i] & 0xf8) / 256.0f);
    }
    /* One channel becomes three. */
    OK(svbrdf_gcn_capture_add_photo(linear, (view = pixels_of(floats, SVBRDF_GCN_PIXEL_FLOAT, WIDTH, HEIGHT, 1), &view), &shot));
    for (i = 0; i < COUNT; i++) {
        CHECK(((const float *)photo(linear, 2).data)[i] == floats[i / 3]);
    }
    svbrdf_gcn_capture_destroy(capture);
    svbrdf_gcn_capture_destroy(linear);
}

static void bad_photos(const svbrdf_gcn_capture *from_disk) {
    static const uint8_t pixels[4 * 4 * 3] = {1, 2, 3};
    static const float not_finite[3] = {0.5f, NAN, 0.5f};
    svbrdf_gcn_capture *capture = host_capture(SVBRDF_GCN_TRANSFER_SRGB, 2.0), *bad = NULL, *made = NULL;
    svbrdf_gcn_material *material = NULL;
    svbrdf_gcn_capture_options options;
    svbrdf_gcn_image_view good = pixels_of(pixels, SVBRDF_GCN_PIXEL_UINT8, 4, 4, 3), view;
    svbrdf_gcn_shot good_shot, shot;
    OK(svbrdf_gcn_shot_init(&good_shot, sizeof good_shot));
    good_shot.camera[2] = good_shot.light[2] = 5;
    good_shot.light_intensity[1] = 70;

    FAILS(svbrdf_gcn_fit_material(NULL, capture, NULL, &material), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "at least one photo");
    OK(svbrdf_gcn_capture_options_init(&options, sizeof options));
    FAILS(svbrdf_gcn_capture_create(2.0, &options, &made), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "transfer");
    options.transfer = SVBRDF_GCN_TRANSFER_LINEAR;
    options.views = &options.view_count;
    FAILS(svbrdf_gcn_capture_create(2.0, &options, &made), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "views");
    CHECK(made == NULL);

#define BAD_VIEW(field, value, status, word) \
    view = good; \
    view.field = value; \
    FAILS(svbrdf_gcn_capture_add_photo(capture, &view, &good_shot), status, word)
    BAD_VIEW(data, NULL, SVBRDF_GCN_ERR_NULL, "pixels.data");
    BAD_VIEW(struct_size, 8, SVBRDF_GCN_ERR_STRUCT_SIZE, "pixels");
    BAD_VIEW(pixel_type, 0, SVBRDF_GCN_ERR_FORMAT, "pixel_type");
    BAD_VIEW(pixel_type, 5, SVBRDF_GCN_ERR_FORMAT, "got 5");
    BAD_VIEW(channels, 0, SVBRDF_GCN_ERR_SHAPE, "channels");
    BAD_VIEW(channels, 5, SVBRDF_GCN_ERR_SHAPE, "got 5");
    BAD_VIEW(channels, INT32_MIN, SVBRDF_GCN_ERR_SHAPE, "channels");
    BAD_VIEW(width, 0, SVBRDF_GCN_ERR_SHAPE, "0 x 4");
    BAD_VIEW(height, 0, SVBRDF_GCN_ERR_SHAPE, "4 x 0");
    BAD_VIEW(width, SIZE_MAX, SVBRDF_GCN_ERR_SHAPE, "pixels");
    BAD_VIEW(height, SIZE_MAX / 12 + 1, SVBRDF_GCN_ERR_SHAPE, "pixels");
    BAD_VIEW(width, (size_t)1 << 31, SVBRDF_GCN_ERR_SHAPE, "at most");
    BAD_VIEW(row_stride, PTRDIFF_MAX, SVBRDF_GCN_ERR_SHAPE, "strides");
    BAD_VIEW(row_stride, PTRDIFF_MIN, SVBRDF_GCN_ERR_SHAPE, "strides");
    BAD_VIEW(pixel_stride, PTRDIFF_MIN, SVBRDF_GCN_ERR_SHAPE, "strides");
    BAD_VIEW(channel_stride, PTRDIFF_MAX, SVBRDF_GCN_ERR_SHAPE, "strides");

#define BAD_SHOT(field, value, status, word) \
    shot = good_shot; \
    shot.field = value; \
    FAILS(svbrdf_gcn_capture_add_photo(capture, &good, &shot), status, word)
    BAD_SHOT(camera[0], NAN, SVBRDF_GCN_ERR_INVALID_ARGUMENT, "camera");
    BAD_SHOT(light[1], INFINITY, SVBRDF_GCN_ERR_INVALID_ARGUMENT, "light");
    BAD_SHOT(camera[2], -5, SVBRDF_GCN_ERR_INVALID_ARGUMENT, "behind the sample");
    BAD_SHOT(light_intensity[1], 0, SVBRDF_GCN_ERR_INVALID_ARGUMENT, "light_intensity");
    BAD_SHOT(light_intensity[0], NAN, SVBRDF_GCN_ERR_INVALID_ARGUMENT, "light_intensity");
    BAD_SHOT(struct_size, 1, SVBRDF_GCN_ERR_STRUCT_SIZE, "shot");
    BAD_SHOT(name, "\xc3", SVBRDF_GCN_ERR_INVALID_ARGUMENT, "UTF-8");
    shot = good_shot;
    shot.name = "links";
    shot.camera[2] = 0;
    FAILS(svbrdf_gcn_capture_add_photo(capture, &good, &shot), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "links");
    CHECK(svbrdf_gcn_capture_photo_count(capture) == 0 && svbrdf_gcn_capture_width(capture) == 0);

    /* After all that it still works, and a photo of another size leaves it as it is. */
    OK(svbrdf_gcn_capture_add_photo(capture, &good, &good_shot));
    view = good;
    view.height = 3;
    FAILS(svbrdf_gcn_capture_add_photo(capture, &view, &good_shot), SVBRDF_GCN_ERR_SHAPE, "4 x 3");
    CHECK(svbrdf_gcn_capture_photo_count(capture) == 1 && svbrdf_gcn_capture_height(capture) == 4);
    FAILS(svbrdf_gcn_capture_add_photo((svbrdf_gcn_capture *)(uintptr_t)from_disk, &good, &good_shot), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "files");

    bad = host_capture(SVBRDF_GCN_TRANSFER_LINEAR, 2.0);
    view = pixels_of(not_finite, SVBRDF_GCN_PIXEL_FLOAT, 1, 1, 3);
    FAILS(svbrdf_gcn_capture_add_photo(bad, &view, &good_shot), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "NaN");
    svbrdf_gcn_capture_destroy(bad);
    bad = host_capture(SVBRDF_GCN_TRANSFER_LINEAR, NAN);
    FAILS(svbrdf_gcn_capture_add_photo(bad, &good, &good_shot), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "patch_size");
    svbrdf_gcn_capture_destroy(bad);
    svbrdf_gcn_capture_destroy(capture);
}

static void put(FILE *file, uint32_t value, int bytes) {
    for (; bytes > 0; bytes--, value >>= 8) {
        fputc((int)(value & 0xff), file);
    }
}

/* An 8-bit RGB TIFF in one strip. */
static void write_tiff(const char *path, const uint8_t *pixels, uint32_t width, uint32_t height) {
    const uint32_t entries[10][4] = {{256, 4, 1, width}, {257, 4, 1, height}, {258, 3, 3, 134},         {259, 3, 1, 1},      {262, 3, 1, 2},
                                     {273, 4, 1, 140},   {277, 3, 1, 3},      {278, 4, 1, height}, {279, 4, 1, width * height * 3}, {284, 3, 1, 1}};
    FILE *file = fopen(path, "wb");
    int i;
    CHECK(file != NULL);
    if (file == NULL) {
        return;
    }
    put(file, 0x002a4949, 4);
    put(file, 8, 4);
    put(file, 10, 2);
    for (i = 0; i < 10; i++) {
        put(file, entries[i][0], 2);
        put(file, entries[i][1], 2);
        put(file, entries[i][2], 4);
        put(file, entries[i][3], 4);
    }
    put(file, 0, 4);
    for (i = 0; i < 3; i++) {
        put(file, 8, 2);
    }
    CHECK(fwrite(pixels, 3, (size_t)width * height, file) == (size_t)width * height);
    CHECK(fclose(file) == 0);
}

/* Photos of a known material, rendered here: from the host's pixels and from files with the same pixels come the same bits, and the material. */
static void known_material(const svbrdf_gcn_capture *shots) {
    char folder[1024], path[2048];
    svbrdf_gcn_material *truth = NULL, *from_host, *from_disk;
    svbrdf_gcn_capture *host = NULL, *disk = NULL;
    svbrdf_gcn_capture_options options;
    svbrdf_gcn_image_buffer buffer;
    svbrdf_gcn_image_view view, half_view;
    size_t width, height, i, j, photos = quick ? 3 : svbrdf_gcn_capture_photo_count(shots);
    uint8_t *bytes;
    float *rendering;
    uint16_t *halves;
    double rmse;
    FILE *description;

    OK(svbrdf_gcn_material_load(path_of(path, samples, "lambert/truth"), &truth));
    view = map(truth, SVBRDF_GCN_MAP_DIFFUSE_ALBEDO);
    width = view.width;
    height = view.height;
    bytes = malloc(width * height * 3);
    rendering = malloc(width * height * 3 * sizeof *rendering);
    halves = malloc(width * height * 3 * sizeof *halves);
    CHECK(bytes != NULL && rendering != NULL && halves != NULL);

    OK(svbrdf_gcn_capture_options_init(&options, sizeof options));
    options.size = size_pixels / 2;
    options.transfer = SVBRDF_GCN_TRANSFER_GAMMA22;
    OK(svbrdf_gcn_capture_create(svbrdf_gcn_material_patch_size(truth), &options, &host));
    mkdir(path_of(folder, out_folder, "c-known"), 0777);
    snprintf(path, sizeof path, "%s/capture.json", folder);
    description = fopen(path, "w");
    CHECK(description != NULL);
    fprintf(description, "{\"format\": \"svbrdf-gcn capture\", \"version\": 1, \"patch_size\": %.17g, \"transfer\": \"gamma2.2\", \"photos\": [\n",
            svbrdf_gcn_material_patch_size(truth));
    for (i = 0; i < photos; i++) {
        svbrdf_gcn_shot shot = shot_of(shots, i);
        OK(svbrdf_gcn_image_buffer_init(&buffer, sizeof buffer));
        buffer.data = rendering;
        buffer.pixel_type = SVBRDF_GCN_PIXEL_FLOAT;
        buffer.channels = 3;
        buffer.width = width;
        buffer.height = height;
        OK(svbrdf_gcn_material_render(truth, &shot, &buffer));
        if (i == 0) {
            /* The same as halves, bottom up. */
            int close = 1;
            buffer.pixel_type = SVBRDF_GCN_PIXEL_HALF;
            buffer.row_stride = -(ptrdiff_t)(width * 6);
            buffer.data = halves + (height - 1) * width * 3;
            OK(svbrdf_gcn_material_render(truth, &shot, &buffer));
            half_view = pixels_of(buffer.data, SVBRDF_GCN_PIXEL_HALF, width, height, 3);
            half_view.row_stride = buffer.row_stride;
            options.transfer = SVBRDF_GCN_TRANSFER_LINEAR;
            options.size = -1;
            {
                svbrdf_gcn_capture *linear = NULL;
                OK(svbrdf_gcn_capture_create(1.0, &options, &linear));
                OK(svbrdf_gcn_capture_add_photo(linear, &half_view, &shot));
                for (j = 0; j < width * height * 3; j++) {
                    close &= fabsf(((const float *)photo(linear, 0).data)[j] - rendering[j]) <= 1e-3f * rendering[j] + 1e-6f;
                }
                svbrdf_gcn_capture_destroy(linear);
            }
            CHECK(close);
            buffer.height--;
            FAILS(svbrdf_gcn_material_render(truth, &shot, &buffer), SVBRDF_GCN_ERR_SHAPE, "expected shape");
            buffer.height++;
            buffer.pixel_type = SVBRDF_GCN_PIXEL_UINT8;
            FAILS(svbrdf_gcn_material_render(truth, &shot, &buffer), SVBRDF_GCN_ERR_FORMAT, "float or half");
            buffer.pixel_type = SVBRDF_GCN_PIXEL_FLOAT;
            shot.camera[2] = -shot.camera[2];
            FAILS(svbrdf_gcn_material_render(truth, &shot, &buffer), SVBRDF_GCN_ERR_INVALID_ARGUMENT, "camera");
            shot.camera[2] = -shot.camera[2];
        }
        for (j = 0; j < width * height * 3; j++) {
            bytes[j] = (uint8_t)(255.0 * pow(fmin(1.0, rendering[j]), 1 / 2.2) + 0.5);
        }
        view = pixels_of(bytes, SVBRDF_GCN_PIXEL_UINT8, width, height, 3);
        OK(svbrdf_gcn_capture_add_photo(host, &view, &shot));
        snprintf(path, sizeof path, "%s/%02d.tif", folder, (int)i);
        write_tiff(path, bytes, (uint32_t)width, (uint32_t)height);
        fprintf(description, "%s{\"file\": \"%02d.tif\", \"camera\": [%.17g, %.17g, %.17g], \"light\": [%.17g, %.17g, %.17g], \"light_intensity\": [%.17g, %.17g, %.17g]}",
                i == 0 ? "" : ",\n", (int)i, shot.camera[0], shot.camera[1], shot.camera[2], shot.light[0], shot.light[1], shot.light[2],
                shot.light_intensity[0], shot.light_intensity[1], shot.light_intensity[2]);
    }
    fprintf(description, "]}\n");
    CHECK(fclose(description) == 0);

    OK(svbrdf_gcn_capture_options_init(&options, sizeof options));
    options.size = size_pixels / 2;
    OK(svbrdf_gcn_capture_open(folder, &options, &disk));
    for (i = 0; i < photos; i++) {
        CHECK(same_pixels(photo(host, i), photo(disk, i)));
    }
    from_host = fit(host);
    from_disk = fit(disk);
    CHECK(same_maps(from_host, from_disk));
    if (!quick) {
        /* The patch is matt, of one albedo. */
        svbrdf_gcn_image_view got = map(from_host, SVBRDF_GCN_MAP_DIFFUSE_ALBEDO), expected = map(truth, SVBRDF_GCN_MAP_DIFFUSE_ALBEDO);
        double means[2][3] = {{0}, {0}};
        for (j = 0; j < got.width * got.height * 3; j++) {
            means[0][j % 3] += ((const float *)got.data)[j] / (double)(got.width * got.height);
        }
        for (j = 0; j < width * height * 3; j++) {
            means[1][j % 3] += ((const float *)expected.data)[j] / (double)(width * height);
        }
        for (j = 0; j < 3; j++) {
            CHECK(fabs(means[0][j] - means[1][j]) < 0.02);
        }
        for (i = 0; i < photos; i++) {
            OK(svbrdf_gcn_photo_rmse(from_host, host, i, &rmse));
            CHECK(rmse < 0.02);
        }
    }
    free(bytes);
    free(rendering);
    free(halves);
    svbrdf_gcn_capture_destroy(host);
    svbrdf_gcn_capture_destroy(disk);
    svbrdf_gcn_material_destroy(truth);
    svbrdf_gcn_material_destroy(from_host);
    svbrdf_gcn_material_destroy(from_disk);
}

int main(int argc, char **argv) {
    static const size_t views[] = {0, 1, 2, 3, 4, 5, 6};
    svbrdf_gcn_capture *capture, *lambert;
    svbrdf_gcn_material *material;
    if (argc < 3) {
        return 2;
    }
    samples = argv[1];
    out_folder = argv[2];
    quick = argc > 3;
    if (quick) {
        size_pixels = 12;
        steps = 6;
    }
    mkdir(out_folder, 0777);

    capture = open_sample("tiles", views, quick ? 3 : 7);
    lambert = open_sample("lambert", NULL, 0);
    material = fit(capture);
    versions();
    null_pointers(capture, material);
    struct_sizes(capture);
    bad_values(capture, material);
    folder_fit(capture, material);
    files(material, capture);
    exports(material);
    other_patches(material);
    color_spaces(material);
    layouts();
    bad_photos(capture);
    known_material(lambert);
    cancelling(capture, material);
    acquiring();
    stated_light();
    two_at_once(capture, material);
    svbrdf_gcn_capture_destroy(capture);
    svbrdf_gcn_capture_destroy(lambert);
    /* Its maps outlive the capture. */
    CHECK(map(material, SVBRDF_GCN_MAP_NORMAL).data != NULL);
    svbrdf_gcn_material_destroy(material);
    printf("C: %d checks passed, %d failed\n", passed, failed);
    return failed != 0;
}
