/* ELF keypoints in C: maxima of a model's saliency, by the ONNX Runtime C API.
 *
 *     ./elf MODEL.onnx PICTURE.ppm [COUNT]
 *
 * prints the COUNT (20) highest "x y saliency" that are the largest of their 11x11 neighbourhood.  The whole
 * post-processing (blur, threshold, suppression, descriptors) is described in docs/contract.md. */
#define _POSIX_C_SOURCE 200112L /* setenv */
#include <stdio.h>
#include <stdlib.h>
#include <onnxruntime_c_api.h>

enum { RADIUS = 5 };
static const OrtApi *ort;

static void check(OrtStatus *status) {
    if (status == NULL) return;
    fprintf(stderr, "elf: %s\n", ort->GetErrorMessage(status));
    exit(1);
}

static void fail(const char *path, const char *reason) {
    fprintf(stderr, "elf: %s: %s\n", path, reason);
    exit(1);
}

/* The next number of a PPM's head, behind white space and comments; -1 if there is none. */
static int head_number(FILE *file) {
    int c = fgetc(file), value;
    while (c == '#' || c == ' ' || c == '\t' || c == '\r' || c == '\n') {
        if (c == '#') while (c != '\n' && c != EOF) c = fgetc(file);
        c = fgetc(file);
    }
    ungetc(c, file);
    return fscanf(file, "%d", &value) == 1 ? value : -1;
}

/* A binary PPM of 8 bits as float B, G, R, 0..255: what the graph takes. */
static float *read_ppm(const char *path, int *width, int *height) {
    FILE *file = fopen(path, "rb");
    if (file == NULL) fail(path, "can't be opened");
    if (fgetc(file) != 'P' || fgetc(file) != '6') fail(path, "not a binary PPM (P6)");
    *width = head_number(file), *height = head_number(file);
    if (*width < 1 || *width > 16384 || *height < 1 || *height > 16384 || head_number(file) != 255)
        fail(path, "not a PPM of 8 bits, at most 16384 pixels wide and high");
    fgetc(file);
    size_t count = (size_t)*width * *height;
    unsigned char *rgb = malloc(3 * count);
    float *bgr = malloc(3 * count * sizeof *bgr);
    if (rgb == NULL || bgr == NULL || fread(rgb, 3, count, file) != count) fail(path, "cut off, or too large");
    for (size_t i = 0; i < count; i++)
        for (int c = 0; c < 3; c++) bgr[3 * i + c] = rgb[3 * i + 2 - c];
    free(rgb), fclose(file);
    return bgr;
}

typedef struct { int x, y; float value; } Peak;

static int by_value(const void *a, const void *b) {
    float x = ((const Peak *)a)->value, y = ((const Peak *)b)->value;
    return (x < y) - (x > y);
}

static int is_peak(const float *map, int width, int height, int x, int y) {
    float centre = map[(size_t)y * width + x];
    for (int v = y - RADIUS; v <= y + RADIUS; v++)
        for (int u = x - RADIUS; u <= x + RADIUS; u++)
            if (u >= 0 && u < width && v >= 0 && v < height && (u != x || v != y)) {
                float other = map[(size_t)v * width + u];
                if (other > centre || (other == centre && (v < y || (v == y && u < x)))) return 0;
            }
    return centre > 0;
}

int main(int argc, char **argv) {
    if (argc < 3 || argc > 4) return fprintf(stderr, "usage: %s MODEL PICTURE.ppm [COUNT]\n", argv[0]), 2;
    int width, height, wanted = argc > 3 ? atoi(argv[3]) : 20, found = 0;
    float *pixels = read_ppm(argv[2], &width, &height), *saliency;
    if ((ort = OrtGetApiBase()->GetApi(ORT_API_VERSION)) == NULL) fail(argv[1], "the ONNX Runtime is too old");

    OrtEnv *env;
    OrtSessionOptions *options;
    OrtSession *session;
    /* ONNX Runtime 1.29 and later would send what is run; 0: unless the user's environment has a word on it. */
    setenv("ORT_DISABLE_TELEMETRY", "1", 0);
    check(ort->CreateEnv(ORT_LOGGING_LEVEL_ERROR, "elf", &env));
    check(ort->CreateSessionOptions(&options));
    check(ort->AddSessionConfigEntry(options, "session.intra_op.allow_spinning", "0"));
    check(ort->CreateSession(env, argv[1], options, &session));

    OrtMemoryInfo *memory;
    OrtValue *image, *output = NULL;
    int64_t shape[] = {1, height, width, 3};
    const char *inputs[] = {"image"}, *outputs[] = {"saliency"};
    check(ort->CreateCpuMemoryInfo(OrtArenaAllocator, OrtMemTypeDefault, &memory));
    check(ort->CreateTensorWithDataAsOrtValue(memory, pixels, sizeof(float) * 3 * width * height, shape, 4,
                                              ONNX_TENSOR_ELEMENT_DATA_TYPE_FLOAT, &image));
    check(ort->Run(session, NULL, inputs, (const OrtValue *const *)&image, 1, outputs, 1, &output));
    check(ort->GetTensorMutableData(output, (void **)&saliency));

    Peak *peaks = malloc(sizeof *peaks * (size_t)width * height);
    if (peaks == NULL) fail(argv[2], "too large");
    for (int y = 0; y < height; y++)
        for (int x = 0; x < width; x++)
            if (is_peak(saliency, width, height, x, y)) peaks[found++] = (Peak){x, y, saliency[(size_t)y * width + x]};
    qsort(peaks, found, sizeof *peaks, by_value);
    for (int i = 0; i < found && i < wanted; i++) printf("%d %d %g\n", peaks[i].x, peaks[i].y, peaks[i].value);

    free(peaks), free(pixels);
    ort->ReleaseValue(output), ort->ReleaseValue(image), ort->ReleaseMemoryInfo(memory);
    ort->ReleaseSession(session), ort->ReleaseSessionOptions(options), ort->ReleaseEnv(env);
    return 0;
}
