// Stand-in for pluginlib: the class is made by a function that the manager looks up.
#pragma once

#define PLUGINLIB_EXPORT_CLASS(class_type, base_type)                        \
  extern "C" __attribute__((visibility("default"))) base_type * standin_make() \
  {                                                                          \
    return new class_type();                                                 \
  }
