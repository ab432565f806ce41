// Stand-in for rclcpp: the macros that log, to stderr.
#pragma once

#include <cstdio>

#include "rclcpp/logger.hpp"

#define STANDIN_LOG(level, logger, ...)                          \
  do {                                                           \
    std::fprintf(stderr, "[" level "] [%s]: ", (logger).get_name()); \
    std::fprintf(stderr, __VA_ARGS__);                           \
    std::fprintf(stderr, "\n");                                  \
  } while (0)

#define RCLCPP_INFO(logger, ...) STANDIN_LOG("INFO", logger, __VA_ARGS__)
#define RCLCPP_WARN(logger, ...) STANDIN_LOG("WARN", logger, __VA_ARGS__)
#define RCLCPP_ERROR(logger, ...) STANDIN_LOG("ERROR", logger, __VA_ARGS__)
