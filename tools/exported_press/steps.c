/* Steps a co-simulation FMU 2.0 and prints its outputs' bits: what check_platforms.py runs on each platform.

   steps LIBRARY RESOURCES TOKEN STEP_S i:REFERENCE... o:REFERENCE... < COURSE
   An input (i:4) follows the course, a number a line, an output (o:7) is printed after each step. */
#include <dlfcn.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef void *(*Instantiate)(const char *, int, const char *, const char *, const void *, int, int);
typedef int (*Setup)(void *, int, double, double, int, double);
typedef int (*Call)(void *);
typedef int (*SetReal)(void *, const uint32_t *, size_t, const double *);
typedef int (*GetReal)(void *, const uint32_t *, size_t, double *);
typedef int (*DoStep)(void *, double, double, int);

static void *library;

static void *function(const char *name) {
    void *found = dlsym(library, name);
    if (!found) {
        fprintf(stderr, "%s: not there\n", name);
        exit(1);
    }
    return found;
}

static void check(int status, const char *what) {
    if (status != 0) {
        fprintf(stderr, "%s: status %d\n", what, status);
        exit(1);
    }
}

int main(int count, char **words) {
    if (count < 6) return 64;
    library = dlopen(words[1], RTLD_NOW);
    if (!library) {
        fprintf(stderr, "%s\n", dlerror());
        return 1;
    }
    void *instance = ((Instantiate)function("fmi2Instantiate"))("steps", 1, words[3], words[2], NULL, 0, 0);
    if (!instance) return 1;
    check(((Setup)function("fmi2SetupExperiment"))(instance, 0, 0.0, 0.0, 0, 0.0), "setup");
    check(((Call)function("fmi2EnterInitializationMode"))(instance), "enter");
    check(((Call)function("fmi2ExitInitializationMode"))(instance), "exit");
    SetReal set = (SetReal)function("fmi2SetReal");
    GetReal get = (GetReal)function("fmi2GetReal");
    DoStep step = (DoStep)function("fmi2DoStep");
    double step_s = atof(words[4]);
    double course;
    for (int number = 0; scanf("%lf", &course) == 1; number++) {
        for (int word = 5; word < count; word++) {
            uint32_t reference = (uint32_t)atol(words[word] + 2);
            if (words[word][0] == 'i') check(set(instance, &reference, 1, &course), "set");
        }
        check(step(instance, number * step_s, step_s, 1), "step");
        for (int word = 5; word < count; word++) {
            uint32_t reference = (uint32_t)atol(words[word] + 2);
            if (words[word][0] != 'o') continue;
            double value;
            uint64_t bits;
            check(get(instance, &reference, 1, &value), "get");
            memcpy(&bits, &value, sizeof bits);
            printf("%016llx ", (unsigned long long)bits);
        }
        putchar('\n');
    }
    return 0;
}
