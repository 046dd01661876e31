// Keypoints of a picture, or matches of two and a picture of them: see README.md.
#include <cstdio>
#include <map>

#include <opencv2/core/utils/logger.hpp>
#include <opencv2/features2d.hpp>

#include "elf.hpp"

static const char *USAGE =
    "usage: elf [OPTIONS] MODEL.onnx PICTURE                  prints x, y and score of its keypoints\n"
    "       elf [OPTIONS] MODEL.onnx FIRST SECOND OUT.png     prints x, y, x, y of the matches, and draws them\n"
    "options: --max-keypoints N   --threshold T   --mask FILE (of the first picture)   --ratio R (0.9; 1: no test)\n";

static double number(const std::string &name, const std::string &text) {
    std::size_t end = 0;
    try {
        const double value = std::stod(text, &end);
        if (end == text.size()) return value;
    } catch (const std::logic_error &) {
    }
    throw elf::Error(name + ": '" + text + "' is no number");
}

static void run(const std::vector<std::string> &files, std::map<std::string, std::string> &given) {
    elf::Options options;
    if (given.count("--max-keypoints"))
        options.max_keypoints = static_cast<std::int64_t>(number("--max-keypoints", given["--max-keypoints"]));
    if (given.count("--threshold")) options.threshold = static_cast<float>(number("--threshold", given["--threshold"]));
    const cv::Mat mask = given.count("--mask") ? elf::read_image(given["--mask"], cv::IMREAD_GRAYSCALE) : cv::Mat();
    const double ratio = given.count("--ratio") ? number("--ratio", given["--ratio"]) : 0.9;

    elf::Detector detector(files[0]);
    elf::Options masked = options;
    masked.mask = mask;
    const cv::Mat picture = elf::read_image(files[1]);
    const elf::Features first = detector.detect(picture, masked);
    if (files.size() == 2) {
        for (const cv::KeyPoint &k : first.keypoints) std::printf("%.9g %.9g %.9g\n", k.pt.x, k.pt.y, k.response);
        return;
    }
    const cv::Mat other = elf::read_image(files[2]);
    const elf::Features second = detector.detect(other, options);
    const std::vector<cv::DMatch> matches = elf::match(first.descriptors, second.descriptors, ratio);
    for (const cv::DMatch &m : matches) {
        const cv::Point2f a = first.keypoints[m.queryIdx].pt, b = second.keypoints[m.trainIdx].pt;
        std::printf("%.9g %.9g %.9g %.9g\n", a.x, a.y, b.x, b.y);
    }
    const auto pair = [&](const std::vector<cv::DMatch> &lines) {
        cv::Mat drawn;
        cv::drawMatches(picture, first.keypoints, other, second.keypoints, lines, drawn, cv::Scalar::all(-1),
                        cv::Scalar::all(-1), {}, cv::DrawMatchesFlags::NOT_DRAW_SINGLE_POINTS);
        return drawn;
    };
    elf::write_image(files[3], 0.5 * pair(matches) + 0.5 * pair({}));  // lines that the pictures show through
}

int main(int argc, char **argv) {
    cv::utils::logging::setLogLevel(cv::utils::logging::LOG_LEVEL_SILENT);  // what goes wrong is said below, once
    std::vector<std::string> files;
    std::map<std::string, std::string> given{};
    for (int i = 1; i < argc; i++) {
        const std::string word = argv[i];
        const bool option = word == "--max-keypoints" || word == "--threshold" || word == "--mask" || word == "--ratio";
        if (!option && word.rfind("--", 0) == 0) return std::fputs(USAGE, stderr), 2;
        if (!option)
            files.push_back(word);
        else if (i + 1 < argc)
            given[word] = argv[++i];
        else
            return std::fputs(USAGE, stderr), 2;
    }
    if (files.size() != 2 && files.size() != 4) return std::fputs(USAGE, stderr), 2;
    try {
        run(files, given);
    } catch (const std::exception &error) {
        std::fprintf(stderr, "elf: %s\n", error.what());
        return 1;
    }
    return 0;
}
