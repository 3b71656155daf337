/* Fits a material to a capture on disk and writes its maps: fit_material CAPTURE OUT */
#include <stdio.h>

#include <svbrdf_gcn/svbrdf_gcn.h>

static int32_t on_progress(void *user_data, const svbrdf_gcn_progress *progress) {
    (void)user_data;
    fprintf(stderr, "\r%zu of %zu steps, loss %.4f ", progress->step, progress->steps, progress->loss);
    return SVBRDF_GCN_CONTINUE;
}

int main(int argc, char **argv) {
    svbrdf_gcn_capture *capture = NULL;
    svbrdf_gcn_material *material = NULL;
    svbrdf_gcn_options options;
    svbrdf_gcn_status status;

    if (argc != 3) {
        fprintf(stderr, "usage: %s CAPTURE OUT\n", argv[0]);
        return 2;
    }
    status = svbrdf_gcn_capture_open(argv[1], NULL, &capture);
    if (status == SVBRDF_GCN_OK) {
        svbrdf_gcn_options_init(&options, sizeof options);
        options.preset = SVBRDF_GCN_PRESET_DRAFT;
        options.progress = on_progress;
        status = svbrdf_gcn_fit_material(NULL, capture, &options, &material);
    }
    if (status == SVBRDF_GCN_OK) {
        status = svbrdf_gcn_material_save(material, argv[2], NULL);
    }
    if (status != SVBRDF_GCN_OK) {
        fprintf(stderr, "%s\n", svbrdf_gcn_last_error_message());
    }
    svbrdf_gcn_material_destroy(material);
    svbrdf_gcn_capture_destroy(capture);
    return status == SVBRDF_GCN_OK ? 0 : 1;
}
