// ELF keypoints in C++17: an end-to-end ELF model (elf-export --end-to-end) run by ONNX Runtime, with OpenCV's types.
//
//     elf::Detector detector("elf.onnx");
//     elf::Features first = detector.detect(elf::read_image("first.jpg"));
//     elf::Features second = detector.detect(elf::read_image("second.jpg"));
//     std::vector<cv::DMatch> matches = elf::match(first.descriptors, second.descriptors, 0.9);
//
// Places are (x, y) in pixels, (0, 0) being the centre of the upper left one.  What goes wrong is an elf::Error, whose
// what() is one line.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <limits>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include <onnxruntime_cxx_api.h>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>

namespace elf {

struct Error : std::runtime_error { using std::runtime_error::runtime_error; };

inline std::string first_line(const std::string &text) { return text.substr(0, text.find('\n')); }
// An image file as 8 bits, B G R; with cv::IMREAD_GRAYSCALE gray, as masks are.
inline cv::Mat read_image(const std::string &path, int flags = cv::IMREAD_COLOR) {
    cv::Mat image;
    try {
        image = cv::imread(path, flags);
    } catch (const cv::Exception &error) {
        throw Error(path + ": " + first_line(error.err));
    }
    if (image.empty()) throw Error(path + ": not there, or no image that OpenCV reads");
    return image;
}

// Write an image file, of the format that the name's ending says.
inline void write_image(const std::string &path, const cv::Mat &image) {
    try {
        if (cv::imwrite(path, image)) return;
    } catch (const cv::Exception &error) {
        throw Error(path + ": " + first_line(error.err));
    }
    throw Error(path + ": can't be written");
}

struct Features {
    std::vector<cv::KeyPoint> keypoints;  // the strongest first; pt is the place, response the score
    cv::Mat descriptors;                  // (K, D) CV_32F of unit length; without columns if the model has none
};

// What may differ from the model's own defaults; what is not set stays as the model has it.
struct Options {
    std::optional<std::int64_t> max_keypoints;  // 0 or more
    std::optional<float> threshold;  // a fraction, 0..1, of the range of the scores; below 0: Kapur's level
    cv::Mat mask;                    // CV_8UC1 of the image's size: keypoints lie where it is not 0
};

class Detector {
public:
    // threads: of ONNX Runtime; 0 is one for each core.
    explicit Detector(const std::string &model, int threads = 0) : name_(once_usable(model)) {
        // ONNX Runtime 1.29 and later would send what is run, unless the environment has a word on it.
#ifdef _WIN32
        if (std::getenv("ORT_DISABLE_TELEMETRY") == nullptr) _putenv_s("ORT_DISABLE_TELEMETRY", "1");
#else
        setenv("ORT_DISABLE_TELEMETRY", "1", 0);
#endif
        try {
            env_ = Ort::Env(ORT_LOGGING_LEVEL_FATAL, "elf");
            Ort::SessionOptions options;
            options.SetIntraOpNumThreads(threads);
            options.AddConfigEntry("session.intra_op.allow_spinning", "0");
            session_ = Ort::Session(env_, std::filesystem::path(model).c_str(), options);
            look_at_signature();
        } catch (const Ort::Exception &error) {
            throw Error(model + ": " + first_line(error.what()));
        }
    }

    // Keypoints of an image of 8 bits: B G R, or gray.
    Features detect(const cv::Mat &image, const Options &options = {}) {
        if (image.empty() || (image.type() != CV_8UC3 && image.type() != CV_8UC1))
            throw Error("an image has 8 bits and 3 channels, B G R, or 1");
        if (!options.mask.empty() && (options.mask.type() != CV_8UC1 || options.mask.size() != image.size()))
            throw Error("a mask has 8 bits, one channel and the size of the image");
        if (options.max_keypoints && *options.max_keypoints < 0) throw Error("max_keypoints is 0 or more");
        if (options.threshold && std::isnan(*options.threshold)) throw Error("threshold is a number");

        cv::Mat pixels, mask = options.mask.isContinuous() ? options.mask : options.mask.clone();
        image.convertTo(pixels, takes_floats_ ? CV_32F : CV_8U);
        std::int64_t most = options.max_keypoints.value_or(0);
        float threshold = options.threshold.value_or(0);
        std::vector<const char *> names{"image"};
        std::vector<Ort::Value> inputs;
        const std::vector<std::int64_t> shape{1, pixels.rows, pixels.cols, pixels.channels()};
        inputs.push_back(takes_floats_ ? tensor(pixels.ptr<float>(), shape) : tensor(pixels.data, shape));
        if (options.max_keypoints) names.push_back("max_keypoints"), inputs.push_back(tensor(&most, {}));
        if (options.threshold) names.push_back("threshold"), inputs.push_back(tensor(&threshold, {}));
        if (!mask.empty()) names.push_back("mask"), inputs.push_back(tensor(mask.data, {mask.rows, mask.cols}));
        try {
            return features(session_.Run(Ort::RunOptions{nullptr}, names.data(), inputs.data(), inputs.size(),
                                         outputs_.data(), outputs_.size()));
        } catch (const Ort::Exception &error) {
            throw Error(name_ + ": " + first_line(error.what()));
        }
    }

private:
    // The name, where the library can be used at all: Ort's objects can't even be destroyed where it can't.
    static const std::string &once_usable(const std::string &model) {
        if (OrtGetApiBase()->GetApi(ORT_API_VERSION) != nullptr) return model;
        throw Error(std::string("the library ONNX Runtime ") + OrtGetApiBase()->GetVersionString() +
                    " is older than the headers that this program was compiled with");
    }

    void look_at_signature() {
        Ort::AllocatorWithDefaultOptions allocator;
        bool detects = false, describes = false, batch = false;
        for (std::size_t i = 0; i < session_.GetOutputCount(); i++) {
            const std::string name = session_.GetOutputNameAllocated(i, allocator).get();
            detects |= name == "keypoints", describes |= name == "descriptors", batch |= name == "counts";
        }
        if (!detects) throw Error(name_ + ": not an end-to-end model (elf-export --end-to-end makes them)");
        if (batch) throw Error(name_ + ": made for batches; elf::Detector takes one image at a time");
        if (session_.GetInputCount() > 1) throw Error(name_ + ": made with 'required'; elf::Detector takes defaults");
        const auto form = session_.GetModelMetadata().LookupCustomMetadataMapAllocated("elf.end_to_end", allocator);
        if (form && std::strstr(form.get(), "\"rgb\"")) throw Error(name_ + ": made for R G B, images here are B G R");
        if (describes) outputs_.push_back("descriptors");
        const Ort::TypeInfo type = session_.GetInputTypeInfo(0);
        takes_floats_ = type.GetTensorTypeAndShapeInfo().GetElementType() == ONNX_TENSOR_ELEMENT_DATA_TYPE_FLOAT;
    }

    // A tensor on memory that stays the caller's.
    template <typename T> Ort::Value tensor(T *values, const std::vector<std::int64_t> &shape) const {
        std::size_t count = 1;
        for (std::int64_t size : shape) count *= static_cast<std::size_t>(size);
        return Ort::Value::CreateTensor<T>(memory_, values, count, shape.data(), shape.size());
    }

    static Features features(const std::vector<Ort::Value> &found) {
        Features features;
        const float *points = found[0].GetTensorData<float>(), *scores = found[1].GetTensorData<float>();
        const std::size_t count = found[1].GetTensorTypeAndShapeInfo().GetElementCount();
        for (std::size_t i = 0; i < count; i++)
            features.keypoints.emplace_back(points[2 * i], points[2 * i + 1], 1.0f, -1.0f, scores[i]);
        if (found.size() == 3) {
            const std::vector<std::int64_t> shape = found[2].GetTensorTypeAndShapeInfo().GetShape();
            features.descriptors.create(static_cast<int>(shape[0]), static_cast<int>(shape[1]), CV_32F);
            const float *rows = found[2].GetTensorData<float>();
            if (count > 0) std::memcpy(features.descriptors.data, rows, sizeof(float) * count * shape[1]);
        }
        return features;
    }

    std::string name_;  // the first: see once_usable
    Ort::Env env_{nullptr};
    Ort::Session session_{nullptr};
    Ort::MemoryInfo memory_ = Ort::MemoryInfo::CreateCpu(OrtArenaAllocator, OrtMemTypeDefault);
    std::vector<const char *> outputs_{"keypoints", "scores"};
    bool takes_floats_ = false;
};

// Mutual nearest neighbours, ties to the lower index, by ascending index of the first side.  A ratio below 1 is Lowe's
// test: the nearest is nearer than ratio times the second nearest.  DMatch::distance is |a - b|.
inline std::vector<cv::DMatch> match(const cv::Mat &first, const cv::Mat &second, double ratio = 1.0) {
    if (!(ratio > 0.0 && ratio <= 1.0)) throw Error("ratio is a number above 0, at most 1");
    if (first.cols == 0 || first.cols != second.cols) throw Error("no descriptors, or of two lengths");
    const float none = -std::numeric_limits<float>::infinity();
    std::vector<int> to_second(first.rows, 0), to_first(second.rows, -1);
    std::vector<float> best(first.rows, none), next(first.rows, none), best_of_second(second.rows, none);
    const cv::Mat products = first.empty() || second.empty() ? cv::Mat() : cv::Mat(first * second.t());
    for (int i = 0; i < products.rows; i++)
        for (int j = 0; j < products.cols; j++) {
            const float product = products.at<float>(i, j);  // |a - b|^2 = 2 - 2 a.b for vectors of unit length
            if (product > best[i])
                next[i] = best[i], best[i] = product, to_second[i] = j;
            else
                next[i] = std::max(next[i], product);
            if (product > best_of_second[j]) best_of_second[j] = product, to_first[j] = i;
        }
    std::vector<cv::DMatch> matches;
    for (int i = 0; i < products.rows; i++) {
        const double near = std::max(2.0 - 2.0 * best[i], 0.0), far = std::max(2.0 - 2.0 * next[i], 0.0);
        if (to_first[to_second[i]] == i && (ratio == 1.0 || near < ratio * ratio * far))
            matches.emplace_back(i, to_second[i], static_cast<float>(std::sqrt(near)));
    }
    return matches;
}

}  // namespace elf
