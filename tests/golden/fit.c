/* The fit of compare.py in C: fit CAPTURE OUT FORMAT */
#include <stdio.h>
#include <string.h>

#include <svbrdf_gcn/svbrdf_gcn.h>

static int32_t format_of(const char *name) {
    if (strcmp(name, "exr") == 0) {
        return SVBRDF_GCN_FORMAT_EXR;
    }
    return strcmp(name, "png16") == 0 ? SVBRDF_GCN_FORMAT_PNG16 : SVBRDF_GCN_FORMAT_TIFF;
}

int main(int argc, char **argv) {
    static const size_t views[] = {6, 0, 2, 4};
    svbrdf_gcn_capture *capture = NULL;
    svbrdf_gcn_material *material = NULL;
    svbrdf_gcn_capture_options capture_options;
    svbrdf_gcn_options options;
    svbrdf_gcn_save_options save_options;
    svbrdf_gcn_status status;

    if (argc != 4) {
        return 2;
    }
    svbrdf_gcn_capture_options_init(&capture_options, sizeof capture_options);
    capture_options.size = 48;
    capture_options.views = views;
    capture_options.view_count = sizeof views / sizeof *views;
    svbrdf_gcn_options_init(&options, sizeof options);
    options.preset = SVBRDF_GCN_PRESET_DRAFT;
    options.seed = 7;
    options.threads = 2;
    svbrdf_gcn_save_options_init(&save_options, sizeof save_options);
    save_options.format = format_of(argv[3]);

    status = svbrdf_gcn_capture_open(argv[1], &capture_options, &capture);
    if (status == SVBRDF_GCN_OK) {
        status = svbrdf_gcn_fit_material(NULL, capture, &options, &material);
    }
    if (status == SVBRDF_GCN_OK) {
        status = svbrdf_gcn_material_save(material, argv[2], &save_options);
    }
    if (status != SVBRDF_GCN_OK) {
        fprintf(stderr, "%s\n", svbrdf_gcn_last_error_message());
    }
    svbrdf_gcn_material_destroy(material);
    svbrdf_gcn_capture_destroy(capture);
    return status != SVBRDF_GCN_OK;
}
