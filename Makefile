# Every target runs a module of ci/ or scenarios/ in the project's own Python environment (made by ci/python, kept in the cache folder).
.DEFAULT_GOAL := help
.PHONY: help demo drive test test-fast test-thorough check bench cluster nodes status down toolchain arm64 images kind-node-image web bundle lock golden reference docs

PYTHON := ci/python
# the name of a folder below scenarios/, and a variant of its scenario.yaml: make demo SCENARIO=three-vehicles VARIANT=small
SCENARIO ?= pose-point-cloud-db-recording
VARIANT ?=
# where a forge shows the files of this repository: make docs SOURCE=https://forge.example.com/robots/robotkube/src/branch/main
SOURCE ?=
# extra parameters, for example: make demo SET="vehicles=3 encounters=1"
SET ?=

# the kind of cluster: embedded is made of this machine's processes and needs nothing else; kind is made of containers by
# the program kind, with Docker or podman; existing is there already, k3s too, and more is known of it
CLUSTER ?= embedded
# how a cluster that is there is reached, from where it pulls images (HOST/PATH, and the file of an authority that is none of the usual
# ones), which Nodes are whose, a file with further values of the platform's chart; YES=1: nobody is asked
KUBECONFIG ?=
CONTEXT ?=
REGISTRY ?=
REGISTRY_CA ?=
AGENTS ?=
VALUES ?=
YES ?=
# an option with one word, which may have spaces and quotes in it, as names of contexts and files do; nothing where it is empty
option = $(if $(strip $(2)),$(1) '$(subst ','\'',$(2))')
CHOSEN = --cluster $(CLUSTER) $(call option,--kubeconfig,$(KUBECONFIG)) $(call option,--context,$(CONTEXT)) $(call option,--registry,$(REGISTRY)) $(call option,--registry-ca,$(REGISTRY_CA)) $(call option,--agents,$(AGENTS)) $(call option,--values,$(VALUES)) $(if $(YES),--yes)

# a file for the image of kind's nodes, instead of the Docker or podman of this machine
ARCHIVE ?=

# for how many minutes the vehicles go on driving after a demo, and with `make drive`; 0: they stand
KEEP_DRIVING ?= 30

help:           ## this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-15s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

demo:           ## a scenario, end to end, on a cluster of its own; the paper's use case if none is named
	@$(PYTHON) -m scenarios.demo $(SCENARIO) $(CHOSEN) --driving $(KEEP_DRIVING) $(addprefix --variant ,$(VARIANT)) $(addprefix --set ,$(SET))

drive:          ## the demo's vehicles drive once more, for KEEP_DRIVING minutes; 0 ends it
	@$(PYTHON) -m scenarios.runner drive $(SCENARIO) $(CHOSEN) --minutes $(KEEP_DRIVING) $(addprefix --variant ,$(VARIANT)) $(addprefix --set ,$(SET))

test-fast:      ## the tests that start no other program: what one runs while writing
	@$(PYTHON) -m ci.test --fast

test:           ## checks and all tests but the slower proofs (one small cluster, shared)
	@$(PYTHON) -m ci.test

test-thorough:  ## the slower proofs
	@$(PYTHON) -m ci.test --thorough

check:          ## layers, style, types, links between pages
	@$(PYTHON) -m ci.check

bench:          ## benchmarks: ratios against a baseline in the same run
	@$(PYTHON) -m benchmarks

cluster:        ## only the cluster with the platform installed
	@$(PYTHON) -m scenarios.demo $(SCENARIO) $(CHOSEN) --until platform $(addprefix --variant ,$(VARIANT)) $(addprefix --set ,$(SET))

nodes:          ## only Nodes that are agents': of a new cluster, or by AGENTS of one that is there (CLUSTER=existing or k3s)
	@$(PYTHON) -m ci.cluster up $(CHOSEN)

status:         ## what runs
	@$(PYTHON) -m ci.cluster status $(CHOSEN)

down:           ## stop the cluster and remove everything it made; of one that is there, what was added
	@$(PYTHON) -m ci.cluster down $(CHOSEN)

toolchain:      ## build the programs of the embedded cluster (cached)
	@$(PYTHON) -m ci.toolchain

arm64:          ## compile everything in Go for arm64, into build/arm64, and inspect it; nothing of it runs here
	@$(PYTHON) -m ci.toolchain.arm64

images:         ## build the container images (cached)
	@$(PYTHON) -m ci.images

kind-node-image: ## an image of kind's nodes (CLUSTER=kind), where kind's own cannot be pulled; ARCHIVE=FILE writes a file
	@$(PYTHON) -m ci.kind_node_image $(addprefix --archive ,$(ARCHIVE))

web:            ## build the forge's pages (cached); images that are built afterwards have them
	@$(PYTHON) -m ci.web

bundle:         ## the platform in one file: images, charts with evidence, Argo CD; for registries and other clusters
	@$(PYTHON) -m ci.bundle

lock:           ## write the lock files anew from operator/pyproject.toml
	@$(PYTHON) -m ci.lock

golden:         ## write the charts' golden renderings anew
	@ROBOTKUBE_GOLDEN=write $(PYTHON) -m pytest -c operator/pyproject.toml -p no:cacheprovider operator/tests/charts/test_rendering.py operator/tests/charts/test_managers.py operator/tests/charts/test_tls.py operator/tests/charts/test_processes_tls.py operator/tests/charts/test_k3s.py operator/tests/charts/test_argocd_server.py

reference:      ## write the generated pages of docs/reference anew
	@$(PYTHON) -m ci.reference
	@$(PYTHON) -m ci.reference.principles

docs:           ## build the documentation as a site, into build/docs/site
	@$(PYTHON) -m ci.docs $(addprefix --source ,$(SOURCE))
